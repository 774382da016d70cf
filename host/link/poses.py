"""Pose forwarding for a vehicle that another ground station flies: no commands are sent."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Generator
from dataclasses import dataclass
from typing import Any

from trimtab.host.base.errors import LinkError
from trimtab.host.link.client import Client
from trimtab.host.link.clock import CameraClock
from trimtab.host.link.drivers import run_port
from trimtab.host.link.keys import StationKey
from trimtab.host.link.ports import Cameras, open_port
from trimtab.host.link.session import Session
from trimtab.host.link.tasks import FindVehicle, Task

LOOK_US = 1_000_000
SILENT_US = 30_000_000
"""Silence after which the vehicle counts as lost."""


@dataclass(frozen=True, kw_only=True)
class Forwarded:
    """Number of poses received and forwarded, and the duration."""

    poses: int
    forwarded: int
    seconds: float

    def to_json(self) -> dict[str, Any]:
        """Return the answer of `trimtab poses --json`."""
        return {"poses": self.poses, "forwarded": self.forwarded, "seconds": self.seconds}


class KeepForwarding(Task):
    """Keep the session running until it is ended from outside. Raises LinkError if the vehicle falls silent.

    Parameters
    ----------
    port
        Name of the port in messages.
    look
        Called every second.
    """

    def __init__(self, port: str, look: Callable[[], None]) -> None:
        super().__init__()
        self._port = port
        self._look = look

    def advance(self, client: Client, now_us: int) -> None:
        if client.heard_us is not None and now_us - client.heard_us > SILENT_US:
            raise LinkError(f"{self._port}: the vehicle has been silent for {SILENT_US / 1e6:g} s")
        self._look()
        self.deadline_us = now_us + LOOK_US


def forward_session(
    port: str,
    camera_delay_us: int,
    *,
    ready: Callable[[], None],
    look: Callable[[Session], None],
    key: StationKey | None = None,
) -> Session:
    """Return a session that forwards poses until it is ended from outside.

    Parameters
    ----------
    ready
        Called once the vehicle has answered.
    look
        Called every second from then on.
    """

    def script(session: Session) -> Generator[Task, Any, None]:
        yield FindVehicle(port)
        ready()
        yield KeepForwarding(port, lambda: look(session))

    return Session(script, CameraClock(camera_delay_us), key)


def forward_port(
    port: str,
    mocap: str,
    camera_delay_us: int,
    *,
    ready: Callable[[], None],
    look: Callable[[Session], None],
    key: StationKey | None = None,
) -> Forwarded:
    """Forward poses until Ctrl-C, SIGTERM or SIGHUP, which is the normal end, and return the counts.

    Raises LinkError or UsageError.
    """
    session = forward_session(port, camera_delay_us, ready=ready, look=look, key=key)
    with contextlib.closing(Cameras(mocap)) as cameras, contextlib.closing(open_port(port)) as line:
        driven = run_port(session, line, cameras)
    if session.error is not None and not isinstance(session.error, KeyboardInterrupt):
        raise session.error
    return Forwarded(poses=session.poses, forwarded=session.forwarded, seconds=driven.wall_s)
