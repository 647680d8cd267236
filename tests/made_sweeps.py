"""A small sweep, and what workers of tests need: a module that other processes can import."""

import os
import signal
import threading
import time

import numpy as np

import treelod as tl
from made_plants import random_crown
from treelod.sweeps import worker
from treelod.techniques import Slicings

PLANT = random_crown(60, trunk=True, name="crown")
OTHER = random_crown(40, seed=2, trunk=True, name="shrub")
SIZE = (56, 48)
GRID = {
    "slicings": {"slice_count": [1, 3], "resolution": [8, 16]},
    "stochastic_pruning": {"shrink": [0.1, 0.4]},
}
QUICK = {"reference_samples": 16, "repeats": 2, "warmup": 0, "progress": False}

ERRORS = [
    f"{name}{on}" for name in ("flip", "rmse", "psnr", "ssim") for on in ("", "_black", "_white")
] + ["max_error", "coverage_bias", "coverage_error", "fragments", "overdraw"]
"""Columns that must be the same bits whoever works."""


def cameras(plant, count=3):
    return tl.orbit(plant, count=count, size=SIZE)


def errors_of(table):
    """Errors by plant, label and view: bits, not numbers, so that NaN equals NaN."""
    rows = table.set_index(["plant", "label", "view"]).sort_index()[ERRORS]
    return {
        index: row.tobytes()
        for index, row in zip(rows.index, rows.to_numpy(np.float64), strict=True)
    }


def kill_on_two_slices():
    """Make slicings of two slices kill their process, as a fault in a library would."""
    build = Slicings.build

    def poisoned(plant, **params):
        if params["slice_count"] == 2:
            os.kill(os.getpid(), signal.SIGKILL)
        return build(plant, **params)

    Slicings.build = poisoned


def kill_once(marker):
    """Make the first process that builds slicings of three slices die."""
    build = Slicings.build

    def poisoned(plant, **params):
        if params["slice_count"] == 3:
            try:
                os.close(os.open(marker, os.O_CREAT | os.O_EXCL))
            except FileExistsError:
                pass
            else:
                os.kill(os.getpid(), signal.SIGKILL)
        return build(plant, **params)

    Slicings.build = poisoned


_calls = []


def count_calls(job):
    """Stand in for a worker's `run`: how often this process was called."""
    _calls.append(job)
    return len(_calls)


class Spans:
    """Records when calls of a function run, and lets them take a while."""

    def __init__(self, secs=0.02):
        self._lock = threading.Lock()
        self._secs = secs
        self.found = []

    def around(self, kind, function):
        def recorded(*args, **kwargs):
            start = time.perf_counter()
            result = function(*args, **kwargs)
            time.sleep(self._secs)
            with self._lock:
                self.found.append((kind, start, time.perf_counter()))
            return result

        return recorded

    def overlapping(self, kind):
        """Pairs of spans that overlap, one of them of this kind."""
        return [
            (a, b)
            for i, a in enumerate(self.found)
            for b in self.found[i + 1 :]
            if kind in (a[0], b[0]) and a[1] < b[2] and b[1] < a[2]
        ]


def record(monkeypatch):
    """Record the spans of errors and of times in this process's workers."""
    spans = Spans()
    for kind in ("error_frames", "frame_times"):
        monkeypatch.setattr(worker, kind, spans.around(kind, getattr(worker, kind)))
    return spans
