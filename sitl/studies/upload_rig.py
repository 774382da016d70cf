"""Rig for uploads in simulated time with the real sender, serial lines, radios, channel, receiver and store.

The vehicle stands on the floor. Its flight processor is complete except for the control law, which is left
out. It is ticked only when a byte arrives, or for its check every 10 ms. Host and processors act on whole
milliseconds.
"""

from __future__ import annotations

from array import array
from collections.abc import Callable
from functools import lru_cache

from trimtab.firmware_model.clock import NEVER_US
from trimtab.firmware_model.flight.parameters import ParameterValues
from trimtab.firmware_model.flight.verdict import check_blob
from trimtab.firmware_model.law import step as law
from trimtab.firmware_model.mcu.flight_mcu import UPDATE_US, FlightMcu
from trimtab.firmware_model.mcu.radio_mcu import BAUD, RadioMcu
from trimtab.firmware_model.mcu.uart import UartPort, connect
from trimtab.firmware_model.storage.flash import Flash
from trimtab.firmware_model.storage.store import ReferenceStore
from trimtab.host.vehicle import Vehicle, load_vehicle, to_parameters
from trimtab.protocol import unsigned
from trimtab.protocol.blobs import Kind
from trimtab.protocol.codec import Codec
from trimtab.protocol.messages import HOST, HOST_RADIO, VEHICLE_RADIO, Message
from trimtab.protocol.signing import SIMULATED_EPOCH, Signer, SigningKey, Verifier
from trimtab.protocol.telemetry import TICK_US
from trimtab.protocol.upload import UploadSender, Verdict
from trimtab.sitl.radio import Radio, RadioChannel
from trimtab.sitl.seeds import Purpose, flight_generator
from trimtab.sitl.vehicle import HOST_RX_BYTES, HOST_TX_BYTES
from trimtab.sitl.world import RadioSettings

OFF_US = 300_000
"""Time from the loss of power until the flight processor receives again."""
_GYRO, _FORCE, _VOLTS = (0.0, 0.0, 0.0), (0.0, 0.0, -9.80665), 16.0


def begin_us(seed: int, number: int) -> int:
    """Return the start of an upload after power-up, with a random phase to the vehicle's messages."""
    phase = int(flight_generator(seed, number, Purpose.MOCAP).integers(100))
    return 250_000 + TICK_US * phase


class AtRest:
    """An engine that replaces the control law: its memory stays constant, and the motors stand still."""

    def __init__(self) -> None:
        self.inputs = {block.name: memoryview(array("d", bytes(8 * block.size))) for block in law.INPUTS}
        self.outputs = {block.name: memoryview(array("d", bytes(8 * block.size))) for block in law.OUTPUTS}
        self._memory, self._memory_out = self.inputs["memory"], self.outputs["memory"]

    def run(self) -> None:
        """Copy the memory from the inputs to the outputs."""
        self._memory_out[:] = self._memory


def remembered(vehicle: Vehicle) -> Callable[..., Verdict]:
    """Return `check_blob` for this vehicle with constant parameters and a cache of verdicts."""
    values = ParameterValues(to_parameters(vehicle))

    @lru_cache(maxsize=64)
    def verdict(kind: int, data: bytes, battery_v: float) -> Verdict:
        return check_blob(kind, data, parameters=values, vehicle_id=vehicle.id, battery_v=battery_v)

    def check(kind: int, data: bytes, *, battery_v: float, **same: object) -> Verdict:
        return verdict(kind, data, battery_v)

    return check


@lru_cache(maxsize=4)
def _vehicle(name: str) -> tuple[Vehicle, Callable[..., Verdict]]:
    vehicle = load_vehicle(name)
    return vehicle, remembered(vehicle)


class VehicleEnd:
    """Radio and flight processor of the vehicle. A reset keeps only the store.

    It is a radio for the channel. `store` is the non-volatile memory, `resets` the number of resets.
    """

    def __init__(self, vehicle: str, store: ReferenceStore) -> None:
        craft, self._check = _vehicle(vehicle)
        self.store = store
        self.resets = 0
        self._parameters = to_parameters(craft)
        self._id = craft.id_bytes
        self._on_us = 0
        self._update_us = 0
        self._power_up()

    @property
    def due_us(self) -> int:
        """Time of the next work."""
        due_us = min(self.radio.due_us, self.flight.uart.due_us, self._update_us)
        return due_us if due_us > self._on_us else self._on_us

    def reset(self, now_us: int) -> None:
        """Cut the power. Everything outside the store is lost."""
        self.resets += 1
        self.store = ReferenceStore(Flash(self.store.flash.image))
        self._on_us = now_us + OFF_US
        self._update_us = 0
        self._power_up()

    @property
    def has_frame(self) -> bool:
        """Whether a frame waits to be sent."""
        return self.radio.has_frame

    @property
    def pose_waits(self) -> bool:
        """Whether a pose waits to be sent: always False, because a vehicle sends none."""
        return False

    def air_send(self, now_us: int) -> bytes | None:
        """Return the next frame to send; None if there is none or no power."""
        return self.radio.air_send(now_us) if now_us >= self._on_us else None

    def air_receive(self, frame: bytes, now_us: int) -> None:
        """Pass the frame to the radio. Without power, it is lost."""
        if now_us >= self._on_us:
            self.radio.air_receive(frame, now_us)

    def tick(self, now_us: int) -> bool:
        """Tick radio and flight processor. Return whether a frame waits to be sent."""
        if now_us < self._on_us:
            return False
        waits = now_us >= self.radio.due_us and self.radio.tick(now_us)
        if now_us >= min(self.flight.uart.due_us, self._update_us):
            self._update_us = now_us - now_us % UPDATE_US + UPDATE_US
            self.flight.tick(now_us, _GYRO, _FORCE, _VOLTS)
        return waits

    def _power_up(self) -> None:
        self.radio = RadioMcu(address=VEHICLE_RADIO)
        self.flight = FlightMcu(
            engine=AtRest(),
            parameters=self._parameters,
            store=self.store,
            uid=1 + self.resets,
            vehicle_id=self._id,
            check=self._check,
        )
        connect(self.flight.uart, self.radio.uart)


class UploadRig:
    """One upload of `blob` to a vehicle that has `old` live.

    Parameters
    ----------
    seed, number
        Seed of the channel's random numbers and of the start of the upload.
    make_sender
        Makes the sender, also after the host was killed.
    on_message
        Called with the time, whether the host sends (True) or receives (False), and the message.
    key
        Key of message signing of host and vehicle; None without signing.
    tap
        Returns a replacement for a radio (True: the ground's) that observes its frames.

    `now_us` is the time since power-up, `begin_us` the start of the upload.
    """

    def __init__(  # noqa: PLR0913 (one keyword for each option)
        self,
        blob: bytes,
        *,
        old: bytes | None,
        radio: RadioSettings,
        seed: int,
        number: int,
        vehicle: str = "research",
        make_sender: Callable[[bytes], UploadSender] = lambda blob: UploadSender(blob, Kind.REFERENCE),
        on_message: Callable[[int, bool, Message], None] = lambda now_us, is_sent, message: None,
        key: SigningKey | None = None,
        tap: Callable[[Radio, bool], Radio] = lambda radio, of_ground: radio,
    ) -> None:
        self.blob, self.old = blob, old
        store = ReferenceStore()
        if old is not None:
            store.stage(Kind.REFERENCE, old)
            store.commit(Kind.REFERENCE)
        if key is not None:
            store.signing.keep(key, SIMULATED_EPOCH - 1)
        self._key = key
        self.vehicle = VehicleEnd(vehicle, store)
        self.ground = RadioMcu(address=HOST_RADIO)
        self.now_us = 0
        self.begin_us = begin_us(seed, number)
        self._make_sender = make_sender
        self._on_message = on_message
        self._port = UartPort(baud=BAUD, rx_bytes=HOST_RX_BYTES, tx_bytes=HOST_TX_BYTES)
        connect(self._port, self.ground.uart)
        self.channel = RadioChannel(
            ground=tap(self.ground, True),
            vehicle=tap(self.vehicle, False),
            settings=radio,
            up_rng=flight_generator(seed, number, Purpose.RADIO_UP),
            down_rng=flight_generator(seed, number, Purpose.RADIO_DOWN),
        )
        self.start_host()

    def start_host(self) -> None:
        """Start a new host that knows only the blob."""
        self.sender = self._make_sender(self.blob)
        self._codec = Codec(*HOST, accepts_unsigned=unsigned.host_accepts)
        if self._key is not None:
            self._codec.signer = Signer(self._key, link_id=0, epoch=SIMULATED_EPOCH)
            self._codec.verifier = Verifier(self._key, epoch=SIMULATED_EPOCH)
        self._deadline_us = max(self.now_us, self.begin_us)

    @property
    def live(self) -> bytes | None:
        """The live blob on board."""
        return self.vehicle.store.live(Kind.REFERENCE)

    def run(self, until_us: int) -> None:
        """Advance to `until_us` or to the end of the upload."""
        while self.now_us < until_us and not self.sender.over:
            self.step(until_us)

    def step(self, until_us: int) -> None:
        """Advance to the time of the next work."""
        host_us = min(self._deadline_us, self._port.due_us)
        due_us = min(self.channel.due_us, self.ground.due_us, self.vehicle.due_us, host_us)
        due_us = -(-max(due_us, self.now_us + TICK_US) // TICK_US) * TICK_US
        self.now_us = now_us = min(due_us, until_us)
        channel, ground = self.channel, self.ground
        if now_us >= channel.due_us:
            channel.tick(now_us)
        if now_us >= ground.due_us and ground.tick(now_us):
            channel.wake(now_us, ground=True)
        if now_us >= self.vehicle.due_us and self.vehicle.tick(now_us):
            channel.wake(now_us, ground=False)
        if now_us >= self._deadline_us or now_us >= self._port.due_us:
            self._host(now_us)

    def _host(self, now_us: int) -> None:
        sender, codec = self.sender, self._codec
        if codec.signer is not None and codec.verifier is not None:
            codec.signer.advance(now_us)
            codec.verifier.advance(now_us)
        if now_us < self.begin_us:
            self._port.read(now_us)
            return
        for message in codec.decode(self._port.read(now_us)):
            sender.receive(message, now_us)
            self._on_message(now_us, False, message)
        sender.advance(now_us)
        for message in sender.send(now_us):
            self._port.write(codec.encode(message), now_us)
            self._on_message(now_us, True, message)
        deadline_us = sender.next_deadline_us()
        self._deadline_us = NEVER_US if deadline_us is None else deadline_us
