"""
How fast does Mesa's llvmpipe draw the same lists? The peer of the benchmarks of frames.

treelod's own GPU backend draws with it, in a process of its own, because llvmpipe's number of
threads is fixed when its first device is made. The process builds the subject that it is given,
draws a frame whenever it is asked to and answers with the seconds that the backend gives: emit,
upload of what is the frame's own, commands, and drawing until llvmpipe is idle. What frames share
was uploaded before, and nothing is read back.
"""

from __future__ import annotations

import contextlib
import json
import os
import subprocess
import sys
import tempfile
import threading
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any

import numpy as np

from treelod import _core
from treelod.bench.subjects import COUNTS, Subject
from treelod.errors import NoAdapterError

if TYPE_CHECKING:
    from types import TracebackType

    from numpy.typing import NDArray

__all__ = ["ADAPTER", "Llvmpipe"]

ADAPTER = "llvmpipe"
"""A part of the name of the adapter."""

_ANSWER_SECS = 120.0
"""A process that has not answered by then hangs; frames take a few seconds at most."""


class Llvmpipe:
    """
    A process that draws one subject with llvmpipe.

    Parameters
    ----------
    subject : Subject
        What it draws.
    samples : int
        Samples a pixel, as in `treelod.render`.
    threads : int
        Threads that rasterise; with 1 llvmpipe has none besides the one that takes commands.

    Raises
    ------
    NoAdapterError
        If there is no llvmpipe (Debian: ``mesa-vulkan-drivers``).
    RuntimeError
        If the process fails, or draws another list.
    """

    def __init__(self, subject: Subject, *, samples: int, threads: int) -> None:
        self._folder = tempfile.TemporaryDirectory(prefix="treelod-llvmpipe-")
        scene = Path(self._folder.name) / "scene.npz"
        subject.store(scene)
        environment = {**os.environ, "LP_NUM_THREADS": str(threads if threads > 1 else 0)}
        # a file: a pipe that nobody empties can stop the process
        self._errors = (Path(self._folder.name) / "errors.txt").open("w+")
        self._process = subprocess.Popen(
            [
                sys.executable,
                "-m",
                "treelod.bench.llvmpipe",
                str(scene),
                str(samples),
                str(threads),
            ],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            stderr=self._errors,
            env=environment,
        )
        try:
            facts = self._answer()
            if "no_adapter" in facts:
                raise NoAdapterError(facts["no_adapter"])
            self.driver: str = facts["driver"]
            _, ours = subject.picture(_core.Renderer(), samples=1)
            expected = {name: ours[name] for name in COUNTS}
            if facts["counts"] != expected:
                msg = f"llvmpipe was given {facts['counts']}, not {expected}"
                raise RuntimeError(msg)
        except BaseException:
            self._close()
            raise

    def __enter__(self) -> Llvmpipe:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._close()

    def draw(self) -> float:
        """Draw a frame and return the seconds it took."""
        return float(self._ask("draw")["secs"])

    def picture(self) -> NDArray[np.float32]:
        """Return what it draws: linear colour and coverage, shape (H, W, 4)."""
        picture: NDArray[np.float32] = np.load(self._ask("picture")["file"])
        return picture

    def _ask(self, what: str) -> dict[str, Any]:
        assert self._process.stdin is not None
        # if it has ended, its last words say why
        with contextlib.suppress(BrokenPipeError):
            self._process.stdin.write(what + "\n")
            self._process.stdin.flush()
        return self._answer()

    def _answer(self) -> dict[str, Any]:
        assert self._process.stdout is not None
        limit = threading.Timer(_ANSWER_SECS, self._process.kill)
        limit.start()
        try:
            line = self._process.stdout.readline()
        finally:
            limit.cancel()
        if not line:
            status = self._process.wait()
            self._errors.seek(0)
            words = self._errors.read().strip().splitlines()[-1:]
            msg = f"llvmpipe ended with status {status}: {' '.join(words)}"
            raise RuntimeError(msg)
        answer: dict[str, Any] = json.loads(line)
        return answer

    def _close(self) -> None:
        # a line that a dead process never read
        with contextlib.suppress(BrokenPipeError):
            self._process.stdin and self._process.stdin.close()
        try:
            self._process.wait(timeout=10)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        self._process.stdout and self._process.stdout.close()
        self._errors.close()
        self._folder.cleanup()


def _serve(scene: Path, samples: int, threads: int, source: IO[str], target: IO[str]) -> None:
    subject, renderer = Subject.load(scene), _core.Renderer()

    def answer(**facts: object) -> None:
        print(json.dumps(facts), file=target, flush=True)

    try:
        _, stats = subject.picture(renderer, samples=1, backend="gpu", adapter=ADAPTER)
    except NoAdapterError as missing:
        answer(no_adapter=str(missing))
        return
    answer(driver=stats["driver"], counts={name: stats[name] for name in COUNTS})
    for line in source:
        if line.strip() == "draw":
            secs = subject.secs(
                renderer, samples=samples, threads=threads, backend="gpu", adapter=ADAPTER
            )
            answer(secs=secs)
        else:
            color, _ = subject.picture(renderer, samples=samples, backend="gpu", adapter=ADAPTER)
            file = scene.with_name("picture.npy")
            np.save(file, color)
            answer(file=str(file))


if __name__ == "__main__":
    _serve(Path(sys.argv[1]), int(sys.argv[2]), int(sys.argv[3]), sys.stdin, sys.stdout)
