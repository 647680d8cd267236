"""How a notebook shows how far a long run is: one line, which is replaced as the run goes on."""

from __future__ import annotations

import sys
import time
from typing import Any

__all__ = ["LiveLine", "is_notebook"]

_LEAST_SECS = 0.2
"""Between two versions of the line: a notebook keeps up with a few a second."""


def is_notebook() -> bool:
    """
    Tell whether what is displayed appears below a notebook's cell.

    Returns
    -------
    bool
    """
    ipython = sys.modules.get("IPython")
    # the shell of a terminal has no kernel
    return ipython is not None and hasattr(ipython.get_ipython(), "kernel")


class LiveLine:
    """
    Shows how far each stage of a long run is, in one line that says nothing of time.

    Called as `treelod.terminal.Stages` is. What stays in the notebook is the last version, the
    same for every run that comes to its end.
    """

    def __init__(self) -> None:
        self._stages: dict[str, str] = {}
        self._handle: Any = None
        self._shown = ""
        self._last = 0.0

    def __enter__(self) -> LiveLine:
        return self

    def __exit__(self, *_: object) -> None:
        self._show()

    def __call__(self, stage: str, done: int, total: int) -> None:
        """
        Show how far a stage is.

        Parameters
        ----------
        stage : str
            Its name.
        done, total : int
            Steps.
        """
        self._stages[stage] = f"{stage}: {done} of {total}"
        now = time.monotonic()
        if now - self._last >= _LEAST_SECS:
            self._last = now
            self._show()

    def _show(self) -> None:
        from IPython.display import display

        text = ", ".join(self._stages.values())
        if text == self._shown:
            return
        self._shown = text
        data = {"text/plain": text}
        if self._handle is None:
            self._handle = display(data, raw=True, display_id=True)  # type: ignore[no-untyped-call]
        else:
            self._handle.update(data, raw=True)
