"""Server of a simulated vehicle in real time on a pty, TCP or UDP port, and of its cameras on a UDP port.

The server follows the wall clock and never skips a tick. If the machine falls behind, simulated time is
stretched and an overrun is counted.
"""

from __future__ import annotations

import contextlib
import select
import socket
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol
from urllib.parse import urlsplit

from trimtab.host.base.lateness import Lateness
from trimtab.sitl.ports import Port, ServeError, address_family, host_port, open_port, wall_us

_BUSY = "the computer is too busy for real time; close other programs, or fly in lock-step, without --port"
_STEP_US = 2000
_LATE_US = 20_000  # a greater delay counts as an overrun and shifts the clock


class Served(Protocol):
    """Interface of a vehicle to the server."""

    @property
    def now_us(self) -> int: ...
    def run_until(self, t_us: int) -> int: ...
    def serial_read(self) -> bytes: ...
    def serial_write(self, data: bytes) -> None: ...
    def serial_room(self) -> int: ...
    def mocap_read(self) -> list[bytes]: ...


@dataclass
class ServeStatistics:
    """Simulated time, number of overruns, total stretch of simulated time, and its greatest lateness."""

    simulated_us: int = 0
    overruns: int = 0
    stretched_us: int = 0
    late_us: float = 0.0


def serve(
    vehicle: Served,
    *,
    port: str,
    stop: Callable[[], bool],
    mocap: str | None = None,
    realtime: bool = True,
    ready: Callable[[str], None] | None = None,
    on_late: Callable[[str], None] | None = None,
) -> ServeStatistics:
    """Run the vehicle in real time at a port until `stop` returns True, and return the statistics.

    Parameters
    ----------
    port
        "pty" (one client), "tcp:HOST:PORT" (listens, several clients) or "udp:HOST:PORT" (listens, and
        answers every peer that has sent something within the last 10 s).
    stop
        Called every few milliseconds.
    mocap
        udp://HOST:PORT that receives one datagram for each pose. None: poses are dropped.
    realtime
        If False, run as fast as the machine allows.
    ready
        Called once with the address to open.
    on_late
        Called with a line when simulated time begins to run late, while it does, and when it is over.

    Raises ServeError if port or mocap cannot be opened.
    """
    with contextlib.ExitStack() as stack:
        camera = stack.enter_context(contextlib.closing(_Datagrams(mocap)))
        line = stack.enter_context(contextlib.closing(open_port(port)))
        if ready is not None:
            ready(line.address)
        return _loop(vehicle, line, camera, stop, realtime, Lateness("simulated time runs", _BUSY, on_late))


def _loop(
    vehicle: Served,
    line: Port,
    camera: _Datagrams,
    stop: Callable[[], bool],
    realtime: bool,
    lateness: Lateness,
) -> ServeStatistics:
    statistics = ServeStatistics()
    first_us = vehicle.now_us
    origin_us = wall_us() - first_us
    while not stop():
        ahead_us = vehicle.now_us - (wall_us() - origin_us) if realtime else 0
        lateness.add(-ahead_us, vehicle.now_us)
        if ahead_us < -_LATE_US:
            statistics.overruns += 1
            statistics.stretched_us -= ahead_us
            origin_us -= ahead_us
        readable, _, _ = select.select(line.waits_on(), [], [], max(0, ahead_us) * 1e-6)
        if readable:
            line.receive()
        if realtime and vehicle.now_us > wall_us() - origin_us:
            continue
        if data := line.read(vehicle.serial_room()):
            vehicle.serial_write(data)
        vehicle.run_until(vehicle.now_us + _STEP_US)
        line.write(vehicle.serial_read())
        for datagram in vehicle.mocap_read():
            camera.send(datagram)
        statistics.simulated_us = vehicle.now_us - first_us
        statistics.late_us = lateness.worst_us
    return statistics


class _Datagrams:
    """Destination of poses: a UDP address, or none."""

    def __init__(self, url: str | None) -> None:
        self._socket: socket.socket | None = None
        if url is None:
            return
        try:
            parts = urlsplit(url)
        except ValueError:  # unclosed brackets, or characters that normalise to punctuation
            parts = None
        if parts is None or parts.scheme != "udp" or not parts.hostname:
            raise ServeError(f"mocap {url}: give it as udp://HOST:PORT")
        host, number = host_port(parts.netloc, url, lowest=1)
        self._socket = socket.socket(address_family(host), socket.SOCK_DGRAM)
        try:
            self._socket.connect((host, number))
        except OSError as error:
            self._socket.close()
            raise ServeError(f"mocap {url}: cannot be reached, {error.strerror}; check the address") from None
        self._socket.setblocking(False)

    def send(self, datagram: bytes) -> None:
        if self._socket is not None:
            with contextlib.suppress(OSError):  # no listener or no route: the datagram is lost
                self._socket.send(datagram)

    def close(self) -> None:
        if self._socket is not None:
            self._socket.close()
