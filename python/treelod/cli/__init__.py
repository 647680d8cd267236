"""
The command line: ``treelod compare``, ``demo``, ``sweep``, ``walk``, ``grow``, ``gpu``,
``bench``, ``validate``.

Progress and errors go to the error stream, results to the output stream. Exit codes: 0 done,
1 failed, 2 wrong usage.
"""

# in the order of the help
from treelod.cli import compare, sweep, walk, grow, gpu, bench, validate  # noqa: F401, I001
from treelod.cli.app import app, main

__all__ = ["app", "main"]
