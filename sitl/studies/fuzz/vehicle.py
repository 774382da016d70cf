"""Fuzz target for the flight processor: bytes on its serial line.

Two flight processors run side by side. One gets the damaged bytes, the other only the valid messages in them
that are addressed to it. After every tick both must have the same state, including the inputs of the control
law and the bytes on the line. So bytes without a valid message change nothing, and damage does not affect
adjacent messages. Rules then check the changes that valid messages cause.

The control law is the real one, compiled. Plant and sensors are replaced by constant measurements with a
little noise, because only reactions to bytes matter.
"""

from __future__ import annotations

import hashlib
import math
from random import Random
from typing import Any

from trimtab.firmware_model.flight.supervisor import FLYING, State
from trimtab.firmware_model.law.constants import GRAVITY
from trimtab.protocol import messages as m
from trimtab.protocol.blobs import Kind
from trimtab.protocol.messages import VEHICLE, mavlink
from trimtab.protocol.telemetry import TICK_US
from trimtab.protocol.upload.transfer import CHUNK_BYTES, tag_of
from trimtab.sitl.studies.fuzz import inputs, mutations
from trimtab.sitl.studies.fuzz.board import Board, Broken, fast_port
from trimtab.sitl.studies.fuzz.inputs import FLUSH, Found, frame, pack, valid_messages
from trimtab.sitl.studies.fuzz.source import Source

LONGEST = 1_600
"""Greatest size of an input. With FLUSH it fits the receive buffer, so that no byte is lost."""
_PARAMETER_SETTERS = {"PARAM_SET", "SET_GPS_GLOBAL_ORIGIN"}
_COMMANDS = ("COMMAND_LONG", "COMMAND_INT")


_STATE = ("state", "failsafe", "action", "rotors", "parameters", "live reference", "staged reference",
          "live feed-forward", "staged feed-forward", "the law's inputs")  # fmt: skip
_PARAMETERS, _ROTORS = 4, 3
_LIVE, _STAGED = (5, 7), (6, 8)


class VehicleTarget:
    """The flight processor in one of several situations, chosen by the integer `situation`.

    `give` takes an input and raises Broken, or any error of the firmware.
    """

    SITUATIONS = ("standby", "flying", "receiving", "armed", "booting", "empty")

    def __init__(self, source: Source, rng: Random, situation: int) -> None:
        name = self.SITUATIONS[situation % len(self.SITUATIONS)]
        loaded = name != "empty"
        self._rng = rng
        self._source = source
        self._a, self._b = (Board(source, fast_port(), loaded=loaded) for _ in range(2))
        self.now_us = 0
        self._asked = self._armed = self._was_flying = False
        self._chunk = 0
        self._uploading = (Kind.REFERENCE, source.reference)
        self._state = self._a.state()
        self.valid = 0
        if name != "booting":
            self._prepare(name)

    def _prepare(self, name: str) -> None:
        """Boot with poses, then bring the flight processor into the situation."""
        for k in range(900):
            if k % 10 == 0:
                self.give(self.pose())
            else:
                self._tick()
        if name in ("flying", "armed"):
            self.give(self.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1.0))
        if name == "flying":
            self.give(self.command(mavlink.MAV_CMD_MISSION_START))
        if name == "receiving":
            for _ in range(3):
                self.give(self.upload_step())

    # Messages of a host.

    def pose(self) -> bytes:
        """Return a pose as the host would forward it at this time."""
        at_us = max(0, self.now_us - 8_000)
        payload = pack(m.AttPosMocap.id, time_usec=at_us, q=(1.0, 0.0, 0.0, 0.0), x=0.0, y=0.0, z=-0.01)
        return frame(m.AttPosMocap.id, payload)

    def command(self, number: int, *parameters: float) -> bytes:
        """Return a COMMAND_LONG to this vehicle."""
        named = {f"param{k}": value for k, value in enumerate(parameters, start=1)}
        payload = pack(m.CommandLong.id, command=number, target_system=1, target_component=1, **named)
        return frame(m.CommandLong.id, payload)

    def upload_step(self) -> bytes:
        """Return the next message of the current upload, or the first of a new one."""
        kind, blob = self._uploading
        digest = _digest(blob)
        chunks = -(-len(blob) // CHUNK_BYTES)
        k, self._chunk = self._chunk, self._chunk + 1
        if k == 0:
            fields = {"size": len(blob), "kind": kind, "chunk": CHUNK_BYTES, "digest": digest}
            return frame(m.UploadBegin.id, pack(m.UploadBegin.id, target_system=1, **fields))
        if k <= chunks:
            data = blob[(k - 1) * CHUNK_BYTES : k * CHUNK_BYTES].ljust(CHUNK_BYTES, b"\0")
            fields = {"tag": tag_of(digest), "index": k - 1, "data": data}
            return frame(m.UploadChunk.id, pack(m.UploadChunk.id, target_system=1, **fields))
        self._chunk = 0
        source, rng = self._source, self._rng
        self._uploading = rng.choice(
            ((Kind.REFERENCE, source.reference), (Kind.FEEDFORWARD, source.feedforward), self._damaged_blob())
        )
        fields = {"at_tick": m.NO_TICK, "kind": kind, "digest": digest}
        return frame(m.UploadCommit.id, pack(m.UploadCommit.id, target_system=1, **fields))

    def _damaged_blob(self) -> tuple[Kind, bytes]:
        blob = bytearray(self._source.reference)
        blob[self._rng.randrange(len(blob))] ^= 1 << self._rng.randrange(8)
        return Kind.REFERENCE, bytes(blob)

    def sensible(self) -> bytes:
        """Return a message that a host could send, which passes the first checks."""
        rng = self._rng
        draw = rng.randrange(12)
        if draw < 4:
            return self.pose()
        if draw < 8:
            return self.upload_step()
        if draw == 8:
            return self.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, rng.choice((1.0, 1.0, 0.0)))
        if draw == 9:
            return self.command(
                rng.choice(inputs.COMMANDS), *(rng.choice((0.0, 1.0, 148.0)) for _ in range(7))
            )
        if draw == 10:
            name, value = rng.choice(list(self._a.mcu.parameters.items()))
            value *= rng.choice((1.0, 0.9, 1.1, -1.0, 100.0, math.nan))
            payload = pack(
                m.ParamSet.id, param_value=value, param_id=name.encode(), target_system=1, param_type=9
            )
            return frame(m.ParamSet.id, payload)
        return frame(m.Timesync.id, pack(m.Timesync.id, tc1=0, ts1=rng.getrandbits(62)))

    # One input.

    def give(self, data: bytes) -> None:
        """Deliver `data` within one tick and check the rules."""
        data = data[:LONGEST]
        found = valid_messages(data + FLUSH)
        self.valid += len(found)
        half = len(data) // 2
        self._a.port.write(data[:half], self.now_us)
        self._a.port.write(data[half:] + FLUSH, self.now_us + 300)
        self._b.port.write(b"".join(one.frame for one in found if _for_us(one)), self.now_us)
        before = self._state
        self._tick()
        self._check_rules(before, self._state, found)

    def _tick(self) -> None:
        self.now_us += TICK_US
        now_us, noise = self.now_us, 1e-3 * (self.now_us // TICK_US % 7)
        for board in (self._a, self._b):
            board.mcu.tick(now_us, (noise, -noise, noise), (0.0, noise, -GRAVITY), 16.0)
        self._check_rotors()
        a, b = self._a.state(), self._b.state()
        self._state = a
        if a != b:
            names = ", ".join(name for name, x, y in zip(_STATE, a, b, strict=True) if x != y)
            raise Broken(f"differs from the state after the valid messages alone: {names}")
        sent_a, sent_b = self._a.messages(now_us + 900), self._b.messages(now_us + 900)
        if sent_a != sent_b:
            raise Broken(
                f"sent messages ({len(sent_a)}) differ from those ({len(sent_b)}) with valid messages alone"
            )

    def _check_rotors(self) -> None:
        command = tuple(self._a.mcu.motor_command)
        if not all(0.0 <= u <= 1.0 for u in command):
            raise Broken(f"motor commands {command}")
        if any(command) and self._a.mcu.state not in FLYING and not self._was_flying:
            raise Broken(f"rotors turn in {self._a.mcu.state.name}")
        self._was_flying = self._a.mcu.state in FLYING

    def _check_rules(self, before: tuple[Any, ...], after: tuple[Any, ...], found: list[Found]) -> None:
        """Check that every change has a message that permits it."""
        kinds = {one.message.get_type() for one in found if _for_us(one)}
        self._asked = self._asked or any(_commits(one) for one in found)
        self._armed = self._armed or not kinds.isdisjoint(_COMMANDS)
        if before[_PARAMETERS] != after[_PARAMETERS]:
            if kinds.isdisjoint(_PARAMETER_SETTERS):
                raise Broken("a parameter changed without a message that sets it")
            if before[0] is not State.STANDBY:
                raise Broken(f"a parameter changed in {before[0].name}")
        for live, staged in zip(_LIVE, _STAGED, strict=True):
            if before[live] != after[live]:
                if not self._asked:
                    raise Broken("a live blob changed without a commit")
                self._asked = False
                named = {bytes(getattr(one.message, "digest", ())) for one in found}
                if after[live] != before[staged] and _digest(after[live]) not in named:
                    raise Broken("what became live was neither staged nor named in this tick")
        if after[_ROTORS] and not before[_ROTORS] and not self._armed:
            raise Broken("rotors were switched on without a command")
        if after[0] is State.STANDBY:
            self._armed = False
        if before[0] is State.STANDBY and after[0] not in (State.STANDBY, State.ARMED) and not self._armed:
            raise Broken(f"from standby to {after[0].name} without a command")


def _for_us(one: Found) -> bool:
    return getattr(one.message, "target_system", 0) in (0, VEHICLE[0])


def _commits(one: Found) -> bool:
    user_1 = getattr(one.message, "command", None) == mavlink.MAV_CMD_USER_1
    return _for_us(one) and (user_1 or one.message.get_type() == "UPLOAD_COMMIT")


def _digest(blob: bytes) -> bytes:
    return hashlib.sha256(blob).digest()


def raw(target: VehicleTarget, rng: Random, source: Source) -> bytes:
    """Return random bytes."""
    return inputs.random_bytes(rng, LONGEST)


def messages(target: VehicleTarget, rng: Random, source: Source) -> bytes:
    """Return messages of the dialect, some of them sensible."""
    if rng.random() < 0.35:
        return target.sensible()
    return b"".join(inputs.random_message(rng) for _ in range(rng.choice((1, 1, 1, 2, 4))))


def recorded(target: VehicleTarget, rng: Random, source: Source) -> bytes:
    """Return damaged recorded bytes of a host."""
    return mutations.mutated(rng, source.up, LONGEST)
