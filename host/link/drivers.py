"""Drivers: they carry bytes between a session and a vehicle in lock-step, or a port and a camera socket.

This is the only module of the link that reads the wall clock.
"""

from __future__ import annotations

import selectors
import signal
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from types import FrameType, TracebackType
from typing import Any, Self

from trimtab.host.base.lateness import Lateness
from trimtab.host.link.ports import Cameras, Port
from trimtab.host.link.session import Session
from trimtab.host.link.vehicle import Vehicle
from trimtab.protocol.signing import EPOCH_UNIX_S, UNIT_US
from trimtab.protocol.telemetry import TICK_US

LATE_US = 20_000
"""If simulated time is behind the wall clock by more than this, it is stretched and an overrun is counted."""
BUSY = "the computer is too busy for real time; close other programs, or fly in lock-step"
"""Cause and remedy of simulated time that runs late."""
READ_WAIT_US = 100_000
"""Longest time between two reads of a port, even if its descriptor reports no data."""


@dataclass
class DriveStatistics:
    """Simulated and wall time of a run, number of overruns, and total stretch of simulated time."""

    session_us: int = 0
    wall_s: float = 0.0
    overruns: int = 0
    stretched_us: int = 0

    @property
    def realtime_factor(self) -> float:
        """Session time over wall time."""
        return self.session_us * 1e-6 / self.wall_s if self.wall_s > 0.0 else 0.0


class Interrupts:
    """Context that counts interrupt signals instead of raising KeyboardInterrupt.

    Every Ctrl-C counts. SIGTERM and SIGHUP count only if they come first, because a terminal that closes may
    send SIGHUP more than once. If SIGHUP was ignored before (nohup), it stays ignored. Of nested contexts,
    only the inner one counts. Outside the main thread the context does nothing.
    """

    def __init__(self) -> None:
        self.count = 0
        self._before: dict[signal.Signals, Any] = {}

    def __enter__(self) -> Self:
        if threading.current_thread() is threading.main_thread():
            numbers = [signal.SIGINT, signal.SIGTERM]
            if signal.getsignal(signal.SIGHUP) is not signal.SIG_IGN:
                numbers.append(signal.SIGHUP)
            self._before = {number: signal.signal(number, self._on_signal) for number in numbers}
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)

    def _on_signal(self, number: int, frame: FrameType | None) -> None:
        self.count = self.count + 1 if number == signal.SIGINT else max(self.count, 1)


def run_lockstep(
    session: Session,
    vehicle: Vehicle,
    *,
    realtime: bool = False,
    interrupt: Callable[[], None] | None = None,
    on_late: Callable[[str], None] | None = None,
) -> DriveStatistics:
    """Run a session with a vehicle in this process, and return the statistics of the run.

    The result or error of the session is in the session.

    Parameters
    ----------
    realtime
        Keep pace with the wall clock, as far as the machine can.
    interrupt
        Called between two steps after Ctrl-C, SIGTERM or SIGHUP. Without it, the session ends immediately.
    on_late
        Called with a line when simulated time begins to run late, while it does, and when it is over.

    Raises any error of the vehicle, for instance that of a foreign plant.
    """
    statistics = DriveStatistics()
    first_us = vehicle.now_us
    begin_s = time.perf_counter()
    origin_us = _wall_us() - first_us
    lateness = Lateness("simulated time runs", BUSY, on_late)
    end = interrupt or (lambda: session.fail(KeyboardInterrupt()))
    step, run_until = session.step, vehicle.run_until
    with Interrupts() as interrupts:
        handled = 0
        now_us = first_us
        while True:  # unlike a loop with a condition, CPython specialises this one
            if session.done:
                break
            out = step(now_us, vehicle.serial_read(), vehicle.mocap_read())
            if out:
                vehicle.serial_write(out)
            if interrupts.count > handled:
                handled = interrupts.count
                end()
            now_us = run_until(max(session.next_deadline_us, now_us + TICK_US))
            if realtime:
                origin_us += _keep_pace(now_us, origin_us, statistics, lateness)
    statistics.session_us = now_us - first_us
    statistics.wall_s = time.perf_counter() - begin_s
    return statistics


def _keep_pace(now_us: int, origin_us: int, statistics: DriveStatistics, lateness: Lateness) -> int:
    """Wait for the wall clock. Return the microseconds by which simulated time must be stretched."""
    ahead_us = now_us - (_wall_us() - origin_us)
    lateness.add(-ahead_us, now_us)
    if ahead_us > 0:
        time.sleep(ahead_us * 1e-6)
        return 0
    if ahead_us > -LATE_US:
        return 0
    statistics.overruns += 1
    statistics.stretched_us -= ahead_us
    return -ahead_us


def run_port(
    session: Session,
    port: Port,
    cameras: Cameras | None = None,
    *,
    interrupt: Callable[[], None] | None = None,
) -> DriveStatistics:
    """Run a session at a port in real time, and return the statistics. Raises LinkError if the port fails."""
    statistics = DriveStatistics()
    end = interrupt or (lambda: session.fail(KeyboardInterrupt()))
    first_us = now_us = _wall_us()
    session.client.set_epoch(wall_timestamp() - now_us // UNIT_US)
    session.utc_offset_us = time.time_ns() // 1000 - now_us
    with Interrupts() as interrupts, selectors.DefaultSelector() as selector:
        selector.register(port, selectors.EVENT_READ)
        if cameras is not None:
            selector.register(cameras, selectors.EVENT_READ)
        handled = 0
        while not session.done:
            wait_us = min(session.next_deadline_us - now_us, READ_WAIT_US)
            selector.select(max(0, wait_us) * 1e-6)
            datagrams = cameras.read() if cameras is not None else []
            data = port.read()
            now_us = _wall_us()
            out = session.step(now_us, data, datagrams)
            if out:
                port.write(out)
            if interrupts.count > handled:
                handled = interrupts.count
                end()
    statistics.session_us = now_us - first_us
    statistics.wall_s = statistics.session_us * 1e-6
    return statistics


def wall_timestamp() -> int:
    """Return the time of the wall clock as a timestamp of signatures."""
    return (time.time_ns() // 1000 - EPOCH_UNIX_S * 1_000_000) // UNIT_US


def _wall_us() -> int:
    return time.monotonic_ns() // 1000
