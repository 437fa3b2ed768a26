"""The one rule for every time that gof gives before it passes: what a model expects, times how slow this machine is.

A model knows the seconds of one machine, `REFERENCE`. How much slower this one is shows in three ways, each better than
the one before:

- a probe: some arithmetic on every core before the work begins (`MachineLoad.measured_now`), in which slow cores show,
  and other programs that use them;
- earlier work of the same kind, and what it took over what its model expected, kept for this user (`Paces`);
- the work itself as it goes on: `TimeLeft`, by which bars say what is left.
"""

from __future__ import annotations

import math
import os
import time
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import ClassVar

from .errors import GofError
from .records import read_record, write_record

PROBES, PROBE_ROUNDS, PROBE_NUMBERS = 4, 200, 50_000  # per core: some hundredths of a second
PROBE_S = 0.020  # CPU seconds of a core for it, on the machine whose seconds the models say
MOST = 32.0  # times slower or quicker: more is a clock that was set, or a machine that slept
LEAST_S = 5.0  # seconds by the model, of work that says something of a pace: less is starts and compiling
NEW = 0.5  # weight of the latest work among all work of its kind, in logarithms
TRUST = 0.1  # of all expected seconds: so much work has to be done before its own pace counts as much as the model's


def folder() -> Path:
    """Return the folder where gof keeps what it has learned of this machine for this user."""
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "gof"


def duration(seconds: float) -> str:
    """Return seconds in words, as exact as a prediction is."""
    if seconds < 90:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 5400 else f"{seconds / 3600:.1f} h"


# ----------------------------------------------------------------
# Before the work begins.


@dataclass(frozen=True)
class MachineLoad:
    """This machine at this moment.

    Attributes:
        slow: CPU seconds of a core here over those on the models' machine.
        crowded: seconds of the clock for a CPU second while all cores have work; 1 where nothing else runs.
    """

    slow: float = 1.0
    crowded: float = 1.0

    @classmethod
    def measured_now(cls) -> MachineLoad:
        """Measure it with probes on every core, a tenth of a second in all.

        The quickest of them counts: on a shared computer each is now and then disturbed for some hundredths of a
        second; other programs at work disturb all of them.
        """
        cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
        least_cpu_s = least_clock_s = math.inf
        with ThreadPoolExecutor(cores) as threads:
            list(threads.map(_probe, [1] * cores))  # the first is slower: threads start and take memory
            for _ in range(PROBES):
                start = time.perf_counter()
                cpu_s = sum(threads.map(_probe, [PROBE_ROUNDS] * cores)) / cores
                least_clock_s = min(least_clock_s, time.perf_counter() - start)
                least_cpu_s = min(least_cpu_s, cpu_s)
        return cls(_bounded(least_cpu_s / PROBE_S), max(_bounded(least_clock_s / max(least_cpu_s, 1e-6)), 1.0))


REFERENCE = MachineLoad()
"""The models' machine: two free cores of a cloud server, which have AVX2 at 2.5 GHz."""


def _probe(rounds: int) -> float:
    """Return CPU seconds of this thread for some arithmetic, in which numpy lets other threads work."""
    import numpy as np  # here: help needs no numbers

    numbers = np.linspace(0, 1, PROBE_NUMBERS, dtype=np.float32)
    start = time.thread_time()
    for _ in range(rounds):
        np.exp(-numbers * numbers).sum()
    return time.thread_time() - start


def _bounded(ratio: float) -> float:
    return min(max(ratio, 1 / MOST), MOST) if math.isfinite(ratio) else 1.0


@dataclass(frozen=True)
class Paces:
    """Seconds that work took on this machine over what its model expected of the models' machine, by kind of work."""

    SCHEMA: ClassVar[str] = "gof-paces"
    VERSION: ClassVar[int] = 1

    ratios: dict[str, float] = field(default_factory=dict)

    @classmethod
    def path(cls) -> Path:
        return folder() / "paces.json"

    @classmethod
    def known(cls) -> Paces:
        """Return those of this user; none where there is no file of them that this version reads."""
        try:
            return read_record(cls, cls.path())
        except GofError:
            return cls()

    def expected_s(self, parts: Mapping[str, float], machine: MachineLoad) -> dict[str, float]:
        """Return seconds on the clock for each part, from a model's seconds by kind of work."""
        return {kind: s * self.ratios.get(kind, machine.slow) * machine.crowded for kind, s in parts.items()}

    def with_run(self, kind: str, ratio: float) -> Paces:
        """Return them after more work of a kind took `ratio` times its model's seconds, a crowded machine aside."""
        if not (math.isfinite(ratio) and ratio > 0):
            return self
        before = self.ratios.get(kind, ratio)
        return replace(self, ratios=self.ratios | {kind: _bounded(before ** (1 - NEW) * ratio**NEW)})

    def without(self, *kinds: str) -> Paces:
        return replace(self, ratios={kind: ratio for kind, ratio in self.ratios.items() if kind not in kinds})

    def keep(self) -> None:
        """Keep them for this user, where a folder for that can be written: nothing else depends on them."""
        try:
            write_record(self.path(), self)
        except OSError:
            pass


# ----------------------------------------------------------------
# While it goes on.


class TimeLeft:
    """Seconds left of work in parts that come one after the other, corrected by its own pace.

    A part goes on at its pace since its first word, and the parts after it are as much slower than expected as those
    before: the less is done, the more the model counts. Work of which nothing was expected is a single part, whose own
    pace is all that is known.
    """

    def __init__(self, expected_s: Mapping[str, float] | None = None, clock: Callable[[], float] = time.monotonic):
        """Args: expected_s: seconds on the clock of each part, in the order in which they come."""
        self.expected_s = dict(expected_s or {})
        self.took_s: dict[str, float] = {}
        """Seconds on the clock of each part that is over."""
        self._clock = clock
        self._part = ""
        self._begun = clock()
        self._first = self._last = (self._begun, 0.0)  # clock and share done of this part's first and last word

    def reach(self, part: str, share: float) -> None:
        """Take note that so much of a part is done, 0..1; the part before it is over."""
        now = self._clock()
        if part != self._part:
            self.end()
            self._part, self._first = part, (now, share)
            if not self.expected_s:  # its own pace, from where it stands
                self._begun = now
        self._last = (now, share)

    def end(self) -> None:
        """Take note that the part at work is over."""
        now = self._clock()
        if self._part:
            self.took_s[self._part] = now - self._begun
        self._part, self._begun = "", now

    @property
    def seconds(self) -> float | None:
        """Seconds left on the clock; None where nothing says it yet."""
        own_s = self.left_here
        if own_s is None:
            return None
        later = [name for name in self.expected_s if name != self._part and name not in self.took_s]
        return own_s + self.slowness * sum(self.expected_s[name] for name in later)

    @property
    def left_here(self) -> float | None:
        """Return seconds left of the part at work; None where nothing says it yet."""
        if not self._part:
            return 0.0 if self.expected_s else None
        (first_s, first), (last_s, share) = self._first, self._last
        made, spent, expected = share - first, last_s - first_s, self.expected_s.get(self._part)
        trust = TRUST if expected else 0.0
        if trust + made <= 0:
            return None
        whole = (trust * self.slowness * (expected or 0.0) + spent) / (trust + made)
        return max(whole * (1 - share) - (self._clock() - last_s), 0.0)  # nothing was heard since, but time went on

    @property
    def slowness(self) -> float:
        """Return seconds of the parts that are over, over what was expected of them."""
        over = [name for name in self.expected_s if name in self.took_s]
        trust = TRUST * sum(self.expected_s.values())
        took, expected = (sum(seconds[name] for name in over) for seconds in (self.took_s, self.expected_s))
        return (trust + took) / (trust + expected) if trust + expected else 1.0
