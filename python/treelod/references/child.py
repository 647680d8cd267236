"""The process that a reference runs in: arrays from one file, arrays to another."""

from __future__ import annotations

import importlib
import json
import sys

import numpy as np


def main(module: str, given: str, made: str, settings: str) -> None:
    """
    Run one job.

    Parameters
    ----------
    module : str
        Name of the module whose `run` does the work.
    given, made : str
        Files of the arrays that go in and come out.
    settings : str
        The rest of the input, as JSON.
    """
    with np.load(given, allow_pickle=False) as file:
        arrays = {name.removeprefix("in_"): file[name] for name in file.files}
    result = importlib.import_module(module).run(arrays, json.loads(settings))
    np.savez(made, **result)


if __name__ == "__main__":
    main(*sys.argv[1:])
