"""How late poses arrive in real time."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

from trimtab.host.base.lateness import LATE_US, Lateness
from trimtab.host.link.clock import LeastDelay

_REMEDY = "the computer or the network is too busy for real time; close other programs"


class Arrivals(NamedTuple):
    """Number of poses, number of late ones, and the greatest lateness in us."""

    poses: int = 0
    late: int = 0
    worst_us: int = 0


class PoseTiming:
    """Lateness of poses: arrival after the stamp, beyond the least such delay of the last half minute.

    on_late: called with a line when poses run late, while they do, and when it is over.
    """

    def __init__(self, on_late: Callable[[str], None] | None = None) -> None:
        self.lateness = Lateness("poses arrive", _REMEDY, on_late)
        self._least = LeastDelay()
        self._arrived = Arrivals()

    def pose(self, stamp_us: int, now_us: int) -> None:
        """Use the stamp of a pose and the time of its arrival."""
        delay_us = now_us - stamp_us
        self._least.add(delay_us, now_us)
        late_us = round(delay_us - self._least.value)
        poses, late, worst_us = self._arrived
        self._arrived = Arrivals(poses + 1, late + (late_us > LATE_US), max(worst_us, late_us))
        self.lateness.add(late_us, now_us)

    def take(self) -> Arrivals:
        """Return what has arrived since the last call."""
        arrived, self._arrived = self._arrived, Arrivals()
        return arrived

    def clear(self) -> None:
        """Discard the least delay: the clocks of vehicle or cameras have jumped against the host's."""
        self._least.clear()
