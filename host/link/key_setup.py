"""Set-up of the signing key of a vehicle that is connected by cable."""

from __future__ import annotations

import contextlib
from collections.abc import Generator
from typing import Any

from trimtab.host.base.errors import LinkError
from trimtab.host.link.client import Client
from trimtab.host.link.drivers import run_port, wall_timestamp
from trimtab.host.link.keys import StationKey
from trimtab.host.link.ports import open_port
from trimtab.host.link.session import Session
from trimtab.host.link.tasks import RETRY_US, FindVehicle, Task
from trimtab.protocol import messages as m
from trimtab.protocol.messages import Message, mavlink
from trimtab.protocol.signing import KEY_BYTES, Verdict, Verifier

PATIENCE_US = 3_000_000


class SetUpKey(Task):
    """Set the vehicle's key, or remove it, until its messages show that it did so.

    Raises LinkError with the vehicle's text if it does not.

    Parameters
    ----------
    key
        The key; None removes the present one.
    timestamp
        Present time as a timestamp of signatures.
    """

    wants = (m.FcStatus,)

    def __init__(self, key: StationKey | None, timestamp: int) -> None:
        super().__init__()
        self._key = key
        self._timestamp = timestamp
        self._verifier = None if key is None else Verifier(key.key, epoch=0)
        self._end_us = 0
        self._texts_before = 0

    def begin(self, client: Client, now_us: int) -> None:
        self._end_us = now_us + PATIENCE_US
        self._texts_before = client.text_count
        self.advance(client, now_us)

    def receive(self, client: Client, message: Message, now_us: int) -> None:
        frame = bytes(message.get_msgbuf())
        if self._verifier is None:
            if not m.is_signed(message):
                self.finish()
        elif self._verifier.check(frame) is Verdict.ACCEPTED:
            self.finish()

    def advance(self, client: Client, now_us: int) -> None:
        if now_us >= self._end_us:
            warnings = client.texts_since(self._texts_before, mavlink.MAV_SEVERITY_WARNING)
            reason = warnings[-1] if warnings else "it does not answer; check the link"
            raise LinkError(f"the vehicle did not change its key: {reason}")
        secret = bytes(KEY_BYTES) if self._key is None else self._key.key.secret
        timestamp = 0 if self._key is None else self._timestamp
        client.send(m.SetupSigning(*m.VEHICLE, list(secret), timestamp))
        self.deadline_us = min(now_us + RETRY_US, self._end_us)


def key_session(key: StationKey | None, port: str, timestamp: int) -> Session:
    """Return a session that installs a key on the vehicle at a port, or removes its key if `key` is None."""

    def script(session: Session) -> Generator[Task, Any, None]:
        yield FindVehicle(port, accept_signed=True)
        yield SetUpKey(key, timestamp)

    return Session(script)


def set_up_key_port(key: StationKey | None, port: str) -> None:
    """Install a key on the vehicle at a serial port, or remove its key if `key` is None. Raises LinkError."""
    session = key_session(key, port, wall_timestamp())
    with contextlib.closing(open_port(port)) as line:
        run_port(session, line)
    session.outcome()
