"""Fuzz target for the radio processors: bytes on their lines and in their frames."""

from __future__ import annotations

from random import Random

from trimtab.firmware_model.law.constants import GRAVITY
from trimtab.firmware_model.mcu.radio_mcu import RadioMcu
from trimtab.firmware_model.mcu.uart import connect
from trimtab.protocol.messages import HOST_RADIO
from trimtab.protocol.telemetry import TICK_US
from trimtab.protocol.uwb_pieces import FRAME_BYTES, PIECE, PIECE_HEADER_BYTES
from trimtab.sitl.studies.fuzz import inputs, mutations
from trimtab.sitl.studies.fuzz.board import Board, Broken, fast_port
from trimtab.sitl.studies.fuzz.inputs import FLUSH, valid_messages
from trimtab.sitl.studies.fuzz.source import Source


class RadioTarget:
    """The vehicle's radio between air and flight processor, and the host's radio between port and air.

    Frames without a valid message must not change the flight processor; a second one without any input serves
    for comparison. The host's radio must send only valid messages, complete or in pieces.
    """

    def __init__(self, source: Source, rng: Random, situation: int) -> None:
        self._rng = rng
        self._radios = [RadioMcu() for _ in range(2)]
        self._a, self._b = (Board(source, radio.uart, loaded=True) for radio in self._radios)
        self._ground = RadioMcu(address=HOST_RADIO)
        self._port = fast_port()
        connect(self._port, self._ground.uart)
        self.now_us = 0
        self.valid = 0
        self._tail = b""
        self._pieces: dict[int, list[bytes]] = {}

    def give(self, data: bytes) -> None:
        """Send the bytes to the host's port and, if they hold no valid message, to the vehicle's radio."""
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
        """Check that a frame holds complete messages, or the next piece of a long message."""
        event = f"the ground radio sends {sent.hex()}"
        if len(sent) > FRAME_BYTES:
            raise Broken(event)
        data, limit = sent, len(sent)
        if sent[0] == PIECE:
            number, index, count = sent[1], sent[2] >> 4, sent[2] & 0x0F
            pieces = self._pieces.setdefault(number, [])
            if index != len(pieces) or index >= count:
                raise Broken(f"{event}, a piece out of order")
            pieces.append(sent[PIECE_HEADER_BYTES:])
            if index + 1 < count:
                return
            data, limit = b"".join(self._pieces.pop(number)), 1
        whole = valid_messages(data)
        if sum(len(one.frame) for one in whole) != len(data) or len(whole) > limit:
            raise Broken(event)

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
    """Return frames of random bytes, of messages, or of recordings."""
    draw = rng.random()
    if draw < 0.4:
        return inputs.random_bytes(rng, 300)
    if draw < 0.6:
        return inputs.random_message(rng)
    return mutations.mutated(rng, source.up, 3 * FRAME_BYTES)
