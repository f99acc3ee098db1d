"""When each step of a run was done, and when to stop: what comparing methods by their time needs."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, field

__all__ = ["Stopwatch"]


@dataclass
class Stopwatch:
    """Notes the time of every step of one run; it starts when it is made.

    Attributes
    ----------
    limit : float
        Time after which no further draw is made [s]. Burn-in is never cut short, as what follows is tuned from it.
    tell : callable, optional
        Called after every step with the seconds since the start.
    wall, cpu : list of float
        Seconds since the start after each step: those of the clock, and those of all cores together.
    """

    limit: float = math.inf
    tell: Callable[[float], None] | None = None
    wall: list[float] = field(default_factory=list)
    cpu: list[float] = field(default_factory=list)
    _begin: tuple[float, float] = field(
        default_factory=lambda: (time.perf_counter(), time.process_time()), init=False, repr=False
    )

    def step(self) -> bool:
        """Note that a step is done; return whether there is time for another."""
        self.wall.append(time.perf_counter() - self._begin[0])
        self.cpu.append(time.process_time() - self._begin[1])
        if self.tell is not None:
            self.tell(self.wall[-1])
        return self.wall[-1] < self.limit
