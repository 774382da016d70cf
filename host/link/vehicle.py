"""Interface of a vehicle that runs in this process, in lock-step with its host.

Simulated vehicles are found through the entry-point group `trimtab.vehicles`. The host does not import them.
"""

from __future__ import annotations

from importlib.metadata import entry_points
from typing import Any, Protocol

from trimtab.host.base.errors import UsageError

GROUP = "trimtab.vehicles"


class Vehicle(Protocol):
    """A vehicle, its radio link up to the host's serial port, and its camera system, on one clock."""

    @property
    def now_us(self) -> int:
        """Time since the vehicle was made, us."""
        ...

    def run_until(self, t_us: int) -> int:
        """Run until `t_us`, or until serial bytes or datagrams wait for the host. Return the time reached."""
        ...

    def serial_read(self) -> bytes:
        """Return the bytes that have arrived at the host's port."""
        ...

    def serial_write(self, data: bytes) -> None:
        """Send bytes from the host's port to the vehicle."""
        ...

    def mocap_read(self) -> list[bytes]:
        """Return the datagrams since the last call; each holds one ATT_POS_MOCAP pose."""
        ...

    def power_cycle(self, flight: int) -> None:
        """Restart at time 0 with empty queues and the given flight index. Uploaded blobs stay."""
        ...

    def close(self) -> None: ...


def vehicle_class(name: str = "sitl") -> Any:
    """Return the class of simulated vehicles registered under `name`. Raises UsageError if there is none."""
    points = {point.name: point for point in entry_points(group=GROUP)}
    if name not in points:
        known = ", ".join(sorted(points)) or "none is installed"
        raise UsageError(f"no simulated vehicle called {name} (known: {known}); install the complete trimtab")
    return points[name].load()
