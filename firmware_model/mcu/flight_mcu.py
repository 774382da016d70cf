"""The flight processor: bytes and sensor samples in, motor commands out. All work is done in its tick."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

from trimtab.firmware_model.clock import NEVER_US
from trimtab.firmware_model.flight import track
from trimtab.firmware_model.flight.engine import Engine
from trimtab.firmware_model.flight.flight import UPDATE_TICKS, Flight
from trimtab.firmware_model.flight.parameters import stored_parameters
from trimtab.firmware_model.flight.supervisor import State
from trimtab.firmware_model.flight.verdict import check_blob
from trimtab.firmware_model.mcu.outbox import Outbox
from trimtab.firmware_model.mcu.swapping import AgreedSwap
from trimtab.firmware_model.mcu.uart import UartPort
from trimtab.firmware_model.services import telemetry
from trimtab.firmware_model.services.handlers import Handlers, Hooks, Identity
from trimtab.firmware_model.services.signing_service import SigningService
from trimtab.firmware_model.services.telemetry import LoopTimes
from trimtab.firmware_model.storage.store import ReferenceStore
from trimtab.protocol import unsigned
from trimtab.protocol.blobs import FeedForward, Kind, Reference, from_bytes
from trimtab.protocol.codec import Codec
from trimtab.protocol.messages import (
    DIALECT_VERSION,
    NO_TICK,
    VEHICLE,
    AttPosMocap,
    FcStatus,
    Message,
    mavlink,
    sender_of,
)
from trimtab.protocol.telemetry import TICK_US
from trimtab.protocol.upload import ReceiverEvent, UploadEvent, UploadReceiver, Verdict

BAUD = 921_600
RX_BYTES = 2_048
TX_BYTES = 4_096
UPDATE_US = UPDATE_TICKS * TICK_US
FOREIGN_US = 5_000_000
"""Interval of the check for messages of another dialect version."""
FOREIGN_COUNT_MIN = 3
"""Least number of wrong checksums in FOREIGN_US that noise does not explain."""
REBOOT_DELAY_US = 500_000
"""Time from the acknowledgement of a reboot to the reboot, in which it reaches the station."""
CATCH_UP_TICKS = 20
"""Greatest number of missed ticks that one tick runs in addition."""


def flight_uart(
    *, baud: int = BAUD, chunk_bytes: int | None = None, idle_us: int = 0, wired: bool = False
) -> UartPort:
    """Return the flight processor's end of the line to the radio processor or the host; see `UartPort`."""
    buffers = {"rx_bytes": RX_BYTES, "tx_bytes": TX_BYTES}
    return UartPort(baud=baud, chunk_bytes=chunk_bytes, idle_us=idle_us, wired=wired, **buffers)


class FlightMcu:
    """One power-up of the flight processor. For a power cycle, build a new object on the same store.

    Parameters
    ----------
    engine
        `law.step` as an engine, used by this processor only.
    parameters
        Values by name of the protocol's table; missing ones take their defaults. Values in the store take
        precedence.
    store
        Non-volatile memory.
    uid
        Unique number of this power-up, at most 18 bytes; sent little-endian as AUTOPILOT_VERSION.uid2.
    vehicle_id
        Id of the vehicle file of the parameters, 6 bytes.
    board_version
        AUTOPILOT_VERSION.board_version: `messages.SIMULATED_BOARD`, the number of a board, or 0 for none.
    uart
        This end of the line to the radio processor or the host; `flight_uart()` by default.
    loop_times
        Returns the timing of the ticks since the last call, as a cycle counter measures it.
    check
        Returns the verdict on a blob; `verdict.check_blob` by default.
    rotor_speed
        Returns the rotor speeds as the motor controllers measure them, over that at the greatest thrust.

    Attributes
    ----------
    motor_command
        View of four numbers in 0..1, updated by each tick. The view itself never changes.
    reboot_us
        Time at which a station has asked the processor to reboot; NEVER_US before.
    late_ticks
        Number of ticks that started later than one tick after the previous one.
    outbox
        Messages that wait for the line, and counts of those that were not sent.

    Raises ValueError for parameters that are out of bounds or inconsistent.
    """

    def __init__(  # noqa: PLR0913 (one keyword for each part)
        self,
        *,
        engine: Engine,
        parameters: Mapping[str, float],
        store: ReferenceStore,
        uid: int,
        vehicle_id: bytes,
        board_version: int = 0,
        uart: UartPort | None = None,
        loop_times: Callable[[int], LoopTimes] = lambda now_us: LoopTimes(0, 0, 0),
        check: Callable[..., Verdict] = check_blob,
        rotor_speed: Callable[[], Sequence[float]] | None = None,
    ) -> None:
        self.uart = flight_uart() if uart is None else uart
        self.reboot_us = NEVER_US
        self.late_ticks = 0
        self.parameters = stored_parameters(parameters, store, vehicle_id)
        self.flight = Flight(engine=engine, parameters=self.parameters)
        self.motor_command = self.flight.outputs["motor_command"]
        self._store = store
        self._blob_check = check
        self._rotor_speed = rotor_speed
        self._identity = Identity(uid=uid, vehicle_id=vehicle_id, board_version=board_version)
        self._battery_v = 0.0
        self._codec = Codec(*VEHICLE, accepts_unsigned=unsigned.vehicle_accepts)
        self.outbox = Outbox(self._codec, self.uart)
        self._signing = SigningService(
            codec=self._codec,
            sign_with=self.outbox.sign_with,
            store=store.signing,
            flight=self.flight,
            wired=self.uart.wired,
        )
        self._agreed_swap = AgreedSwap(self.flight, self.parameters)
        self._upload = UploadReceiver(
            store,
            check=self._check,
            may_commit=lambda kind: self._disarmed(),
            agree=self._agreed_swap.agree,
            capacity=store.blob_bytes_max,
        )
        self._services = Handlers(
            flight=self.flight,
            parameters=self.parameters,
            upload=self._upload,
            store=store,
            identity=self._identity,
            hooks=Hooks(
                send=self.outbox.queue,
                status=self._status,
                battery_v=lambda: self._battery_v,
                on_upload=self._uploaded,
                on_limits=self._limits_changed,
                on_parameter=store.settings.change,
                on_reboot=self._plan_reboot,
                on_key_setup=self._signing.set_up,
                is_authentic=self._signing.is_authentic,
            ),
        )
        self._last_us = -TICK_US
        self._update_us = 0
        self._status_us = 0
        self._heartbeat_us = 0
        self._loop_times = loop_times
        self._foreign_us = FOREIGN_US
        self._foreign = 0
        self.flight.texts.extend((mavlink.MAV_SEVERITY_WARNING, fault) for fault in store.faults)
        for kind in Kind:
            self._load(kind)

    @property
    def state(self) -> State:
        """State of the flight."""
        return self.flight.state

    def tick(
        self, now_us: int, gyro: Sequence[float], specific_force: Sequence[float], battery_v: float
    ) -> None:
        """Run one tick. `motor_command` applies until the next tick.

        Parameters
        ----------
        now_us
            Time since power-up in us.
        gyro, specific_force
            Samples in rad/s and m/s^2, FRD.
        battery_v
            Battery voltage.
        """
        if now_us >= self.uart.due_us:
            self._receive(now_us)
        if now_us - self._last_us != TICK_US:
            self._catch_up(now_us, gyro, specific_force)
        self._last_us = now_us
        if now_us >= self._agreed_swap.at_us:
            self._swap(now_us)
        self.flight.tick(now_us, gyro, specific_force)
        if now_us >= self._update_us:
            self._battery_v = battery_v
            self._update(now_us)

    def _receive(self, now_us: int) -> None:
        """Handle the messages that have arrived; send the answers at once."""
        flight, services = self.flight, self._services
        for message in self._signing.receive(self.uart.read(now_us), now_us):
            if isinstance(message, AttPosMocap):
                if services.ownership.admit_pose(sender_of(message), now_us):
                    flight.pose(message.time_usec, (message.x, message.y, message.z), message.q, now_us)
            else:
                services.receive(message, now_us)
        self.outbox.flush(now_us, self._signing.before_send)

    def _update(self, now_us: int) -> None:
        """Run checks, services and telemetry, every UPDATE_TICKS."""
        self._update_us = now_us - now_us % UPDATE_US + UPDATE_US
        flight = self.flight
        streams = self._services.streams
        self._signing.advance(now_us)
        flight.update(now_us, self._battery_v)
        if not self._disarmed():
            self.reboot_us = NEVER_US  # armed since the reboot was accepted
        if self._agreed_swap.at_us < NEVER_US and flight.state is not State.TRACKING:
            self._call_off(now_us)
        if not self._link_reserved_for_upload(
            now_us
        ):  # 100 Hz telemetry pauses during an upload on the floor
            self._send_100_hz(now_us)
        while flight.texts:  # before the status that shows what they explain
            self._services.text(*flight.texts.popleft())
        if now_us >= self._status_us or flight.changed:
            self._status_us = now_us - now_us % telemetry.STATUS_US + telemetry.STATUS_US
            if flight.changed or streams.periodic_due(FcStatus.id, now_us):
                flight.changed = False
                self.outbox.queue(self._status(now_us))
        if now_us >= self._heartbeat_us:
            self._heartbeat_us = now_us - now_us % telemetry.HEARTBEAT_US + telemetry.HEARTBEAT_US
            self.outbox.queue(telemetry.heartbeat(flight))
        self._services.update(now_us)
        if now_us >= self._foreign_us:
            self._notice_foreign(now_us)
        self.outbox.flush(now_us, self._signing.before_send)

    def _send_100_hz(self, now_us: int) -> None:
        streams = self._services.streams
        try:
            for message in telemetry.messages_100_hz(self.flight, now_us, self._rotor_speed):
                if not streams.slowed or streams.periodic_due(message.id, now_us):
                    self.outbox.queue(message)
        except (ValueError, OverflowError):
            self.outbox.unsendable += 1

    def _notice_foreign(self, now_us: int) -> None:
        """Report messages of another dialect version: their checksums are wrong."""
        self._foreign_us = now_us + FOREIGN_US
        count, self._foreign = self._codec.bad_checksums - self._foreign, self._codec.bad_checksums
        if count >= FOREIGN_COUNT_MIN:
            text = f"{count} unknown messages; dialect here is {DIALECT_VERSION}"
            self._services.text(mavlink.MAV_SEVERITY_WARNING, text)

    def _catch_up(self, now_us: int, gyro: Sequence[float], specific_force: Sequence[float]) -> None:
        """Run the missed ticks with the present samples: a step of the control law is always one tick."""
        self.late_ticks += 1
        self.flight.monitor.record_late_tick(now_us)
        first_us = max(self._last_us + TICK_US, now_us - CATCH_UP_TICKS * TICK_US)
        for missed_us in range(first_us, now_us, TICK_US):
            self.flight.tick(missed_us, gyro, specific_force)

    def _status(self, now_us: int) -> Message:
        upload = self._upload
        staged_kind, staged_id = upload.staged()
        board = telemetry.OnBoard(
            vehicle_id=self._identity.vehicle_id,
            reference_id=upload.live_id(Kind.REFERENCE),
            feedforward_id=upload.live_id(Kind.FEEDFORWARD),
            staged_id=staged_id,
            staged_kind=staged_kind,
            battery_v=self._battery_v,
            loop=self._loop_times(now_us),
            late_ticks=self.late_ticks,
            uart_overruns=self.uart.overruns,
            swap_tick=NO_TICK if upload.at_tick is None else upload.at_tick,
            bad_bytes=self._codec.bad_bytes,
        )
        return telemetry.status(self.flight, now_us, board)

    def _plan_reboot(self, now_us: int) -> None:
        self.reboot_us = now_us + REBOOT_DELAY_US

    # Blobs.

    def _check(self, kind: int, blob: bytes) -> Verdict:
        return self._blob_check(
            kind,
            blob,
            parameters=self.parameters,
            vehicle_id=self._identity.vehicle_id.hex(),
            battery_v=self._battery_v,
        )

    def _disarmed(self) -> bool:
        return self.flight.state in (State.BOOT, State.STANDBY)

    def _link_reserved_for_upload(self, now_us: int) -> bool:
        return self._disarmed() and self._upload.in_progress(now_us)

    def _uploaded(self, event: ReceiverEvent) -> None:
        self.flight.changed = True
        if event.event is UploadEvent.COMMITTED and self._disarmed():
            self._load(event.kind)  # in flight the swap is already done

    def _limits_changed(self) -> None:
        """Check the live reference and the staged blob again."""
        self._load(Kind.REFERENCE)
        now_us = self._last_us
        self._services.report_upload(self._upload.limits_changed(now_us), now_us)

    # Swap in flight.

    def _swap(self, now_us: int) -> None:
        """Change the track at the agreed tick and make the staged reference live."""
        if self._upload.at_tick is not None and self._agreed_swap.run():
            self._services.report_upload(self._upload.swap_done(now_us), now_us)
        else:
            self._call_off(now_us)

    def _call_off(self, now_us: int) -> None:
        self._agreed_swap.call_off()
        self._upload.call_off(now_us)
        self._services.report_upload([], now_us)

    def _load(self, kind: int) -> None:
        """Load the live blob of this kind for the next flight if it passes the check."""
        data = self._store.live(kind)
        verdict = None if data is None else self._check(kind, data)
        if verdict is not None and not verdict.ok:
            node = "" if verdict.node is None else f" at node {verdict.node}"
            for text in (f"live blob refused{node}:", verdict.message):
                self.flight.texts.append((mavlink.MAV_SEVERITY_WARNING, text))
        blob = from_bytes(data) if data is not None and verdict is not None and verdict.ok else None
        if kind == Kind.REFERENCE:
            self.flight.reference = None
            if isinstance(blob, Reference):
                self.flight.reference = track.track(blob.nodes_ned(), blob.yaw_nodes())
        else:
            self.flight.feedforward.clear()
            if isinstance(blob, FeedForward):
                self.flight.feedforward.load(blob)
