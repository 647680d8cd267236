"""The process that a reference runs in: arrays from one file, arrays to another."""

from __future__ import annotations

import importlib
import json
import os
import sys
import threading
import time

import numpy as np

_LOOK_SECS = 0.25


def end_with_parent() -> None:
    """Let this process end when the one that started it is gone, killed for example."""
    parent = os.getppid()

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(_LOOK_SECS)
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


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
    end_with_parent()
    main(*sys.argv[1:])
