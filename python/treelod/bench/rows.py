"""What a benchmark gives back: one row a case and peer, ready for JSON."""

from __future__ import annotations

import json
import math
import statistics
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field

from treelod import _core
from treelod.provenance import core_count, cpu_name

__all__ = ["Row", "Timing", "interleaved"]


@dataclass(frozen=True, kw_only=True)
class Row:
    """
    The same work done by treelod and by a peer, in turns, on the same machine.

    Attributes
    ----------
    group : str
        Benchmark: "raster" or "bake", for example.
    case : str
        What was done: input, size, samples, threads.
    ours_secs : float
        Median time of treelod, in seconds.
    peer : str
        Who else did it.
    peer_secs : float
        Median time of the peer, in seconds.
    ours_error, peer_error : float or None
        Error against the benchmark's reference; None where none was measured.
    error_kind : str
        Which error that is; empty where there is none.
    aim : float or None
        Speed-up that is aimed for; None where there is no aim.
    version : str
        Version of treelod.
    cpu : str
        Name of the processor.
    threads : int
        Logical processors that the process may run on; how many were used, a case says.
    spread : float or None
        Half the distance between the quartiles of a time, over its median; the larger of both
        sides. None where a side's rounds are not known.
    """

    group: str
    case: str
    ours_secs: float
    peer: str
    peer_secs: float
    ours_error: float | None = None
    peer_error: float | None = None
    error_kind: str = ""
    aim: float | None = None
    version: str = _core.__version__
    cpu: str = field(default_factory=cpu_name)
    threads: int = field(default_factory=core_count)

    @property
    def spread(self) -> float | None:
        """How far the rounds of the less steady side spread."""
        spreads = [getattr(secs, "spread", None) for secs in (self.ours_secs, self.peer_secs)]
        return None if None in spreads else max(spread for spread in spreads if spread is not None)

    @property
    def speedup(self) -> float:
        """How many times faster than the peer treelod is."""
        return self.peer_secs / self.ours_secs

    def to_json(self) -> str:
        """
        Return the row as one line of JSON, its keys in a fixed order.

        Raises
        ------
        ValueError
            If a number is not finite.
        """
        facts = asdict(self)
        keys = list(facts)
        facts["speedup"] = self.speedup
        keys.insert(keys.index("peer_secs") + 1, "speedup")
        facts["spread"] = self.spread
        return json.dumps({key: facts[key] for key in [*keys, "spread"]}, allow_nan=False)


class Timing(float):
    """Median seconds of some rounds, which know how far those spread."""

    spread: float
    """Half the distance between the quartiles, over the median."""

    @classmethod
    def of(cls, rounds: Sequence[float]) -> Timing:
        """
        Sum up rounds.

        Parameters
        ----------
        rounds : sequence of float
            Seconds, at least one.

        Returns
        -------
        Timing
        """
        timing = cls(statistics.median(rounds))
        timing.spread = 0.0
        if len(rounds) > 1:
            first, _, third = statistics.quantiles(rounds, n=4, method="inclusive")
            timing.spread = (third - first) / 2.0 / timing
        return timing


def interleaved(
    runs: Mapping[str, Callable[[], float | None]],
    *,
    repeats: int,
    warmup: int = 1,
    lead_in: int = 0,
) -> dict[str, Timing]:
    """
    Time several ways to do the same work, taking turns.

    Taking turns spreads whatever else the machine does over all of them alike.

    Parameters
    ----------
    runs : mapping of str to callable
        Each does the work once. One that times itself returns its seconds; one that returns None
        is timed from outside.
    repeats : int
        Rounds that are counted, at least 1.
    warmup : int, default 1
        Rounds that come first and are not counted.
    lead_in : int, default 0
        How often each does the work in every round before the time that is counted. With 0 each
        finds in the caches what the others left there; a frame of many in a row finds its own.

    Returns
    -------
    dict of str to Timing
        Median seconds of each.

    Raises
    ------
    ValueError
        If `repeats` is below 1, or if a run reports a time that is not finite and positive.

    Examples
    --------
    >>> interleaved({"fast": lambda: 1.0, "slow": lambda: 3.0}, repeats=3)
    {'fast': 1.0, 'slow': 3.0}
    """
    if repeats < 1:
        msg = f"repeats must be at least 1, got {repeats}"
        raise ValueError(msg)
    secs: dict[str, list[float]] = {name: [] for name in runs}
    for turn in range(-warmup, repeats):
        for name, run in runs.items():
            for _ in range(lead_in):
                run()
            start = time.perf_counter()
            reported = run()
            spent = time.perf_counter() - start if reported is None else reported
            if not (math.isfinite(spent) and spent > 0.0):
                msg = f"{name} reports {spent} seconds"
                raise ValueError(msg)
            if turn >= 0:
                secs[name].append(spent)
    return {name: Timing.of(spent) for name, spent in secs.items()}
