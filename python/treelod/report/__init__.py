"""The report of a comparison: one page to read, tables to compute with, pictures to cite."""

from treelod.report.page import write_report

__all__ = ["write_report"]
