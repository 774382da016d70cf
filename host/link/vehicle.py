"""What the flight director needs of a vehicle that runs in this process, in lock-step with its host.

Simulated vehicles are found through the entry-point group `trimtab.vehicles`; nothing here imports them.
"""

from __future__ import annotations

from importlib.metadata import entry_points
from typing import Any, Protocol

from trimtab.host.base.errors import UsageError

GROUP = "trimtab.vehicles"


class Vehicle(Protocol):
    """A vehicle, its radio link up to the host's serial port, and its camera system, on one clock."""

    now_us: int

    def run_until(self, t_us: int) -> int:
        """Return the time afterwards: `t_us`, or earlier where serial bytes or datagrams wait for the
        host.
        """
        ...

    def serial_read(self) -> bytes:
        """Return the bytes that have arrived at the host's port."""
        ...

    def serial_write(self, data: bytes) -> None:
        """Bytes leave the host."""
        ...

    def mocap_read(self) -> list[bytes]:
        """Return the poses that have arrived since the last call, one ATT_POS_MOCAP a datagram."""
        ...

    def power_cycle(self, flight: int) -> None:
        """Time begins anew at 0 with empty queues and the given flight index; uploaded blobs stay."""
        ...

    def close(self) -> None: ...


def vehicle_class(name: str = "sitl") -> Any:
    """Return the class of simulated vehicles registered under `name`.

    Raises UsageError where there is none.
    """
    found = {point.name: point for point in entry_points(group=GROUP)}
    if name not in found:
        known = ", ".join(sorted(found)) or "none is installed"
        raise UsageError(f"no simulated vehicle called {name} (known: {known}); install trimtab as a whole")
    return found[name].load()
