"""The report of a comparison: one page to read, tables to compute with, pictures to cite."""

from treelod.report.page import check_folder, write_report

__all__ = ["check_folder", "write_report"]
