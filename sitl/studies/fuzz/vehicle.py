"""Bytes towards the vehicle: into the flight processor's line, and through the radios.

Two flight processors run side by side. One gets the damaged bytes, the other only the valid messages that
are in them and meant for it. After every tick both must be in the same state, down to all that the law is
given and all that goes out on the line: so bytes without a valid message change nothing, and damage costs
none of its neighbours. What valid messages may change is then checked by rules.

The law is the real one, compiled; body and sensors are not there (a vehicle that hangs in the air, with a
little noise), since only reactions to bytes are looked at.
"""

from __future__ import annotations

import hashlib
import math
from random import Random
from typing import Any

from trimtab.firmware_model.flight.supervisor import FLYING, State
from trimtab.firmware_model.law import step as law
from trimtab.firmware_model.law.constants import GRAVITY
from trimtab.firmware_model.mcu.flight_mcu import FlightMcu, flight_uart
from trimtab.firmware_model.mcu.radio_mcu import RadioMcu
from trimtab.firmware_model.mcu.uart import UartPort, connect
from trimtab.firmware_model.storage.store import ReferenceStore
from trimtab.host.codegen import function_engine
from trimtab.host.vehicle import to_parameters
from trimtab.protocol import messages as m
from trimtab.protocol.blobs import Kind
from trimtab.protocol.messages import HOST_RADIO, VEHICLE, mavlink
from trimtab.protocol.stream import StreamSplitter, message_id
from trimtab.protocol.telemetry import TICK_US
from trimtab.protocol.upload.transfer import CHUNK_BYTES, tag_of
from trimtab.protocol.uwb_pieces import FRAME_BYTES, PIECE, PIECE_HEADER_BYTES
from trimtab.sitl.studies.fuzz import inputs
from trimtab.sitl.studies.fuzz.inputs import FLUSH, Found, frame, pack, valid_messages
from trimtab.sitl.studies.fuzz.source import Source
from trimtab.sitl.vehicle import traced_law

BAUD = 100 * 921_600
"""So fast that an input arrives within one tick."""
LONGEST = 1_600
"""Bytes of an input: with FLUSH less than the receive buffer, so that none are lost."""
_TOLD = (m.FcStatus.id, m.StatusText.id, m.SysStatus.id)
"""Messages that count bad bytes or speak of them."""
_COMMANDS = ("COMMAND_LONG", "COMMAND_INT")


class Broken(Exception):
    """Something happened that must not; the text says what."""


class _Board:
    """A flight processor with its store; `port` is the other end of its line."""

    def __init__(self, source: Source, port: UartPort, *, loaded: bool) -> None:
        vehicle = source.vehicle
        self.store = ReferenceStore()
        if loaded:
            for kind, blob in ((Kind.REFERENCE, source.reference), (Kind.FEEDFORWARD, source.feedforward)):
                self.store.stage(kind, blob)
                self.store.commit(kind)
        self.engine = function_engine(traced_law(), law.INPUTS, law.OUTPUTS)
        self.mcu = FlightMcu(
            engine=self.engine,
            parameters=to_parameters(vehicle),
            store=self.store,
            uid=7,
            vehicle_id=vehicle.id_bytes,
            uart=flight_uart(baud=port.baud),
        )
        self.port = port
        connect(port, self.mcu.uart)
        self._splitter = StreamSplitter()
        self._vector: Any = None
        self._values: tuple[float, ...] = ()
        self._looks = 0

    def _parameters(self) -> tuple[float, ...]:
        """All values; read anew where the law's own were replaced, else every 16th time: there are many."""
        parameters = self.mcu.parameters
        self._looks += 1
        if parameters.vector is not self._vector or self._looks % 16 == 0:
            self._vector, self._values = parameters.vector, tuple(parameters.values())
        return self._values

    def state(self) -> tuple[Any, ...]:
        """Return what only a valid message, or time, may change."""
        flight, store = self.mcu.flight, self.store
        return (
            flight.state,
            flight.failsafe,
            flight.action,
            flight.rotors_on,
            self._parameters(),
            *(part(kind) for kind in Kind for part in (store.live, store.staged)),
            b"".join(self.engine.inputs.values()),
        )

    def said(self, now_us: int) -> list[bytes]:
        """Messages sent since the last call, without their numbers, and without those that count damage."""
        frames = self._splitter.feed(self.port.read(now_us))
        return [f[5:-2] for f in frames if message_id(f) not in _TOLD]


def _fast_port() -> UartPort:
    return UartPort(baud=BAUD, rx_bytes=1 << 16, tx_bytes=1 << 16)


_STATE = ("state", "failsafe", "action", "rotors", "parameters", "live reference", "staged reference",
          "live feed-forward", "staged feed-forward", "the law's inputs")  # fmt: skip
_PARAMETERS, _ROTORS = 4, 3
_LIVE, _STAGED = (5, 7), (6, 8)


class VehicleTarget:
    """The flight processor in one of several situations, chosen by `situation` (any whole number).

    `give` is called with each input and raises Broken, or whatever the firmware raises.
    """

    SITUATIONS = ("standby", "flying", "receiving", "armed", "booting", "empty")

    def __init__(self, source: Source, rng: Random, situation: int) -> None:
        name = self.SITUATIONS[situation % len(self.SITUATIONS)]
        loaded = name != "empty"
        self._rng = rng
        self._source = source
        self._a, self._b = (_Board(source, _fast_port(), loaded=loaded) for _ in range(2))
        self.now_us = 0
        self._asked = self._armed = self._was_flying = False
        self._chunk = 0
        self._uploading = (Kind.REFERENCE, source.reference)
        self._state = self._a.state()
        self.valid = 0
        if name != "booting":
            self._prepare(name)

    def _prepare(self, name: str) -> None:
        """Boots with poses; then what the situation asks for."""
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

    # What a host would send.

    def pose(self) -> bytes:
        """Return a pose as the host would forward it now."""
        at_us = max(0, self.now_us - 8_000)
        payload = pack(m.AttPosMocap.id, time_usec=at_us, q=(1.0, 0.0, 0.0, 0.0), x=0.0, y=0.0, z=-0.01)
        return frame(m.AttPosMocap.id, payload)

    def command(self, number: int, *parameters: float) -> bytes:
        """COMMAND_LONG to this vehicle."""
        named = {f"param{k}": value for k, value in enumerate(parameters, start=1)}
        payload = pack(m.CommandLong.id, command=number, target_system=1, target_component=1, **named)
        return frame(m.CommandLong.id, payload)

    def upload_step(self) -> bytes:
        """Return the next message of an upload that is under way or begins."""
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
        """Something that a host sends: so that messages get beyond the first check."""
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
        """Deliver `data` within one tick and check what may not change."""
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
            what = ", ".join(name for name, x, y in zip(_STATE, a, b, strict=True) if x != y)
            raise Broken(f"not as with the valid messages alone: {what}")
        said_a, said_b = self._a.said(now_us + 900), self._b.said(now_us + 900)
        if said_a != said_b:
            raise Broken(
                f"{len(said_a)} messages said, {len(said_b)} with the valid messages alone, or others"
            )

    def _check_rotors(self) -> None:
        command = tuple(self._a.mcu.motor_command)
        if not all(0.0 <= u <= 1.0 for u in command):
            raise Broken(f"motor commands {command}")
        if any(command) and self._a.mcu.state not in FLYING and not self._was_flying:
            raise Broken(f"rotors turn in {self._a.mcu.state.name}")
        self._was_flying = self._a.mcu.state in FLYING

    def _check_rules(self, before: tuple[Any, ...], after: tuple[Any, ...], found: list[Found]) -> None:
        """Check that what changed was changed by a message that may."""
        kinds = {one.message.get_type() for one in found if _for_us(one)}
        self._asked = self._asked or any(_commits(one) for one in found)
        self._armed = self._armed or not kinds.isdisjoint(_COMMANDS)
        if before[_PARAMETERS] != after[_PARAMETERS]:
            if "PARAM_SET" not in kinds:
                raise Broken("a parameter changed without PARAM_SET")
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
    """Any bytes."""
    return inputs.random_bytes(rng, LONGEST)


def messages(target: VehicleTarget, rng: Random, source: Source) -> bytes:
    """Messages of the dialect, sensible ones among them."""
    if rng.random() < 0.35:
        return target.sensible()
    return b"".join(inputs.random_message(rng) for _ in range(rng.choice((1, 1, 1, 2, 4))))


def recorded(target: VehicleTarget, rng: Random, source: Source) -> bytes:
    """Return what a host once sent, damaged."""
    return inputs.mutated(rng, source.up, LONGEST)


class RadioTarget:
    """Radio processors: the vehicle's between air and flight processor, the host's between port and air.

    Frames without a valid message must not change the flight processor, whose twin hears nothing; whatever
    the host's port gets, only valid messages leave for the air, whole or in pieces that make one.
    """

    def __init__(self, source: Source, rng: Random, situation: int) -> None:
        self._rng = rng
        self._radios = [RadioMcu() for _ in range(2)]
        self._a, self._b = (_Board(source, radio.uart, loaded=True) for radio in self._radios)
        self._ground = RadioMcu(address=HOST_RADIO)
        self._port = _fast_port()
        connect(self._port, self._ground.uart)
        self.now_us = 0
        self.valid = 0
        self._tail = b""
        self._pieces: dict[int, list[bytes]] = {}

    def give(self, data: bytes) -> None:
        """Send the bytes through the air into the host's port."""
        self._port.write(data, self.now_us)
        found = valid_messages(self._tail + data)
        self.valid += len(found)
        if not found:
            self._tail = (self._tail + data)[-len(FLUSH) :]
            for start in range(0, len(data), FRAME_BYTES) if self._rng.random() < 0.9 else (0,):
                self._radios[0].air_receive(data[start : start + FRAME_BYTES], self.now_us)
                self._tick()
        self._tick()
        for _ in range(4):
            sent = self._ground.air_send(self.now_us)
            if sent is not None:
                self._check_sent(sent)

    def _check_sent(self, sent: bytes) -> None:
        """Check that a frame holds whole messages, or the next piece of one too long for a frame."""
        what = f"the ground radio sends {sent.hex()}"
        if len(sent) > FRAME_BYTES:
            raise Broken(what)
        data, most = sent, len(sent)
        if sent[0] == PIECE:
            number, index, count = sent[1], sent[2] >> 4, sent[2] & 0x0F
            pieces = self._pieces.setdefault(number, [])
            if index != len(pieces) or index >= count:
                raise Broken(f"{what}, a piece out of order")
            pieces.append(sent[PIECE_HEADER_BYTES:])
            if index + 1 < count:
                return
            data, most = b"".join(self._pieces.pop(number)), 1
        whole = valid_messages(data)
        if sum(len(one.frame) for one in whole) != len(data) or len(whole) > most:
            raise Broken(what)

    def _tick(self) -> None:
        self.now_us += TICK_US
        now_us = self.now_us
        self._ground.tick(now_us)
        self._port.read(now_us)
        for board, radio in zip((self._a, self._b), self._radios, strict=True):
            radio.tick(now_us)
            board.mcu.tick(now_us, (0.0, 0.0, 0.0), (0.0, 0.0, -GRAVITY), 16.0)
            radio.air_send(now_us)
        if self._a.state() != self._b.state():
            raise Broken("frames without a valid message changed the flight processor")


def radio_frames(target: RadioTarget, rng: Random, source: Source) -> bytes:
    """Frames of any bytes, of messages, and of recordings."""
    draw = rng.random()
    if draw < 0.4:
        return inputs.random_bytes(rng, 300)
    if draw < 0.6:
        return inputs.random_message(rng)
    return inputs.mutated(rng, source.up, 3 * FRAME_BYTES)
