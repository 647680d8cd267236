"""Loaded by workers of a test's cluster: cells of two slices kill them."""

from made_sweeps import kill_on_two_slices

kill_on_two_slices()
