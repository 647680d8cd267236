"""Lets ``python -m treelod`` do what ``treelod`` does."""

from treelod.cli import main

main()
