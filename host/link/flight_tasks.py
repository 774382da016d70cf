"""Tasks that wait for poses and follow a flight."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

from trimtab.host.base.errors import LinkError
from trimtab.host.link.client import NEVER_US, Client
from trimtab.host.link.session import Session
from trimtab.host.link.tasks import (
    PATIENCE_US,
    Task,
)
from trimtab.protocol import messages as m
from trimtab.protocol.messages import Message, mavlink

POSES_FIRST = 5
SILENCE_US = 30_000_000
"""Silence after which the host gives up. A vehicle that has lost its host lands by itself."""
STRAY_US = 2_000_000
"""Time after arming during which a standby status is ignored, because it may be older than arming."""
_STANDBY = mavlink.TRIMTAB_STATE_STANDBY


class Interrupted(Exception):
    """The flight is to end; `FlightDirector.interrupt` raises this in the script."""


class TakenOver(Exception):
    """Another station's command has changed the flight, and the vehicle is still in the air."""


class AwaitPoses(Task):
    """Wait until poses are forwarded to the vehicle. Raises LinkError if none arrive."""

    CHECK_US = 20_000

    def __init__(self, session: Session, cameras: str) -> None:
        super().__init__()
        self._session = session
        self._cameras = cameras

    def begin(self, client: Client, now_us: int) -> None:
        self._end_us = now_us + PATIENCE_US
        self._first = self._session.forwarded
        self.deadline_us = now_us + self.CHECK_US

    def advance(self, client: Client, now_us: int) -> None:
        if self._session.forwarded >= self._first + POSES_FIRST:
            self.finish()
        elif now_us >= self._end_us:
            raise LinkError(
                f"{self._cameras}: no poses in {PATIENCE_US / 1e6:g} s; check that it sends to this address"
            )
        else:
            self.deadline_us = now_us + self.CHECK_US


class Companion(Protocol):
    """What the host does during a flight beside following it: a swap, or a controller's stream."""

    wants: tuple[type[Message], ...]

    @property
    def deadline_us(self) -> int: ...
    def status(self, client: Client, message: m.FcStatus, now_us: int) -> None: ...
    def receive(self, client: Client, message: Message, now_us: int) -> None: ...
    def advance(self, client: Client, now_us: int) -> None: ...


class FollowFlight(Task):
    """Follow a flight. The result is the standby FC_STATUS after it. Raises LinkError after long silence."""

    CHECK_US = 500_000

    def __init__(self, on_phase: Callable[[m.FcStatus], None], companion: Companion | None) -> None:
        super().__init__()
        self.wants = (m.FcStatus,) if companion is None else (m.FcStatus, *companion.wants)
        self._on_phase = on_phase
        self._companion = companion
        self._armed = False

    def begin(self, client: Client, now_us: int) -> None:
        self._begin_us = now_us
        self._check_us = now_us + self.CHECK_US
        self._wake()

    def _wake(self) -> None:
        companion_us = NEVER_US if self._companion is None else self._companion.deadline_us
        self.deadline_us = min(self._check_us, companion_us)

    def receive(self, client: Client, message: Message, now_us: int) -> None:
        if not isinstance(message, m.FcStatus):
            if self._companion is not None:
                self._companion.receive(client, message, now_us)
                self._wake()
            return
        if self._companion is not None:
            self._companion.status(client, message, now_us)
            self._wake()
        self._on_phase(message)
        if message.state > _STANDBY:
            self._armed = True
        elif self._armed or now_us - self._begin_us > STRAY_US:
            self.finish(message)

    def advance(self, client: Client, now_us: int) -> None:
        if self._companion is not None and now_us >= self._companion.deadline_us:
            self._companion.advance(client, now_us)
        if now_us < self._check_us:
            self._wake()
            return
        heard_us = self._begin_us if client.heard_us is None else client.heard_us
        if now_us - heard_us >= SILENCE_US:
            raise LinkError(
                f"the vehicle has been silent for {SILENCE_US / 1e6:g} s; it lands by itself, check on it"
            )
        self._check_us = now_us + self.CHECK_US
        self._wake()
