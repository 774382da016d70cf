"""Fuzz target for the host: bytes at its port, and datagrams of the camera system.

Two sessions run side by side. One gets the damaged bytes, the other the valid messages in them. Both must
send the same bytes and have the same state. A recorder writes the log of the first.
"""

from __future__ import annotations

import itertools
import tempfile
from pathlib import Path
from random import Random
from typing import Any

from trimtab.host.base.errors import SESSION_ERRORS
from trimtab.host.link.client import Client
from trimtab.host.link.clock import CameraClock
from trimtab.host.link.parameter_tasks import ReadParameters, SetParameter
from trimtab.host.link.recorder import Recorder
from trimtab.host.link.session import Script, Session
from trimtab.host.link.tasks import Command, FindVehicle, FreshStatus, SettleClock
from trimtab.host.link.upload_tasks import SendBlob
from trimtab.host.log import LogWriter, Provenance
from trimtab.protocol import messages as m
from trimtab.protocol.blobs import Kind, Reference
from trimtab.protocol.codec import Codec
from trimtab.protocol.messages import mavlink
from trimtab.sitl.studies.fuzz import inputs, mutations
from trimtab.sitl.studies.fuzz.board import Broken
from trimtab.sitl.studies.fuzz.inputs import FLUSH, frame, pack, valid_messages
from trimtab.sitl.studies.fuzz.source import Source

LONGEST = 1_600
STEP_US = 7_000


class HostTarget:
    """A session that runs one task after the other.

    `give` takes bytes or a tuple of datagrams. It raises Broken, or any undocumented error of the link.
    """

    def __init__(self, source: Source, rng: Random, situation: int) -> None:
        self._source = source
        self._sessions = tuple(_session(source, situation) for _ in range(2))
        self.now_us = 0
        self.valid = 0
        a = self._sessions[0]
        a.step(0)
        self._sessions[1].step(0)
        self._folder = tempfile.TemporaryDirectory()
        provenance = Provenance(vehicle=source.vehicle, reference=source.reference)
        self._log = LogWriter(Path(self._folder.name) / "flight.mcap", provenance)
        reference = Reference.from_bytes(source.reference)
        a.listener = Recorder(self._log, a.client, a.camera, reference, 0)

    def close(self) -> None:
        """Close and remove the log."""
        self._log.close()
        self._folder.cleanup()

    def give(self, data: bytes | tuple[bytes, ...]) -> None:
        """Advance one step with `data` at the port or in datagrams."""
        a, b = self._sessions
        self.now_us += STEP_US
        if isinstance(data, tuple):
            valid_ones = [one for datagram in data for one in valid_messages(datagram)]
            valid = [one.frame for one in valid_ones]
            answers = (a.step(self.now_us, b"", data), b.step(self.now_us, b"", valid))
        else:
            valid_ones = valid_messages(data + FLUSH)
            answers = (
                a.step(self.now_us, data + FLUSH),
                b.step(self.now_us, b"".join(one.frame for one in valid_ones)),
            )
        self.valid += len(valid_ones)
        for session in self._sessions:
            if session.error is not None:
                raise session.error
            if session.done:
                raise Broken("the session ended")
        if answers[0] != answers[1]:
            raise Broken("the host answers differently than to the valid messages alone")
        states = [_state(session) for session in self._sessions]
        if states[0] != states[1]:
            raise Broken("the host's state differs from that after the valid messages alone")


def _session(source: Source, situation: int) -> Session:
    return Session(lambda _: _script(source, situation), CameraClock((None, 4_000)[situation % 2]))


def _script(source: Source, situation: int) -> Script:
    """Yield all kinds of tasks again and again, whatever the answers."""
    for k in itertools.count(situation):
        task = (
            lambda: FindVehicle("port"),
            lambda: SettleClock(),
            lambda: FreshStatus(),
            lambda: ReadParameters(),
            lambda: SetParameter("MASS", 0.75),
            lambda: Command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, (1.0,), what="arming"),
            lambda: SendBlob(source.reference, Kind.REFERENCE, what="the reference"),
        )[k % 7]()
        try:
            yield task
        except SESSION_ERRORS:
            continue


def _state(session: Session) -> tuple[Any, ...]:
    client: Client = session.client
    clock = client.clock
    return (
        client.heartbeat and client.heartbeat.get_msgbuf(),
        client.status and client.status.get_msgbuf(),
        client.texts,
        client.radio_counts,
        client.heard_us,
        client.others,
        (clock.exchanges, clock.offset_us, clock.rtt_us),
        (session.poses, session.forwarded),
        client.codec.received,
    )


_VEHICLE_SAYS = tuple(
    kind.id
    for kind in (
        m.Heartbeat,
        m.Timesync,
        m.FcStatus,
        m.FcControl,
        m.FcEstimate,
        m.FcObserver,
        m.FcRotors,
        m.StatusText,
        m.RadioStats,
        m.Ping,
        m.ParamValue,
        m.CommandAck,
        m.AutopilotVersion,
        m.UploadStatus,
        m.UploadVerdict,
    )
)


def _vehicle(rng: Random) -> tuple[int, int]:
    return (1, rng.choice((1, 1, 1, 68))) if rng.random() < 0.85 else (255, 68)


def raw(target: HostTarget, rng: Random, source: Source) -> bytes:
    """Return random bytes."""
    return inputs.random_bytes(rng, LONGEST)


def messages(target: HostTarget, rng: Random, source: Source) -> bytes:
    """Return messages of the dialect, mostly types that a vehicle sends."""
    draw = rng.random()
    if draw < 0.1:
        sent_us = target.now_us - 1000 * rng.choice((0, 5, 20, 400))
        payload = pack(m.Timesync.id, tc1=1000 * target.now_us + 12_345_678, ts1=1000 * max(0, sent_us))
        return frame(m.Timesync.id, payload, sender=m.VEHICLE)
    numbers = _VEHICLE_SAYS if draw < 0.8 else tuple(inputs.KINDS)
    return b"".join(inputs.random_message(rng, numbers, _vehicle) for _ in range(rng.choice((1, 1, 2, 4))))


def recorded(target: HostTarget, rng: Random, source: Source) -> bytes:
    """Return damaged recorded bytes of a vehicle."""
    return mutations.mutated(rng, source.down, LONGEST)


def datagrams(target: HostTarget, rng: Random, source: Source) -> tuple[bytes, ...]:
    """Return datagrams of the camera system: damaged, from other programs, or with unusual values."""
    return tuple(_datagram(target, rng, source) for _ in range(rng.choice((1, 1, 2, 3))))


def _datagram(target: HostTarget, rng: Random, source: Source) -> bytes:
    draw = rng.random()
    if draw < 0.15:
        return inputs.random_bytes(rng, 300)
    if draw < 0.45:
        return inputs.random_message(rng, (m.AttPosMocap.id,), lambda _: m.CAMERAS)
    if draw < 0.6:
        return mutations.mutated(rng, source.poses, 300)
    stamp_us = max(0, target.now_us - rng.choice((0, 4_000, 5_000, 30_000, -20_000)))
    made = Codec(*m.CAMERAS).encode(m.AttPosMocap(stamp_us, [1.0, 0.0, 0.0, 0.0], 0.1, 0.2, -0.3))
    return made if draw < 0.9 else mutations.mutated_file(rng, made)
