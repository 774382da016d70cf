"""Recorder of a flight: it logs the messages that pass the host, on the host's clock from arm."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from math import cos, sin
from typing import Any, cast

import numpy as np

from trimtab.host.link.client import Client
from trimtab.host.link.clock import CameraClock
from trimtab.host.link.control_stream import StepRecord
from trimtab.host.link.host_control import HostControl
from trimtab.host.link.link_counts import LinkCounts
from trimtab.host.link.pose_timing import PoseTiming
from trimtab.host.log import LogWriter, topics
from trimtab.host.log.display import PERIOD_US
from trimtab.host.log.provenance import HOST_CONTROL
from trimtab.host.log.tracking import reference_at
from trimtab.host.log.writer import Stamps
from trimtab.protocol import messages as m
from trimtab.protocol.blobs import Reference
from trimtab.protocol.generated import flight_pb2, host_control_pb2, timing_pb2
from trimtab.protocol.messages import Message, mavlink
from trimtab.protocol.telemetry import (
    OVERTAKEN_TICKS,
    TICK_US,
    IntervalDecoder,
    decode_age,
    decode_quaternion,
    decode_rotor_speed,
)

LINK_US = 100_000
_AGE_UNKNOWN_US = 6_553_500
_FLOWN = (mavlink.TRIMTAB_STATE_TRACKING, mavlink.TRIMTAB_STATE_HOLD)
_OFFBOARD = mavlink.TRIMTAB_STATE_OFFBOARD


class Recorder:
    """Log of one flight. `arm_us` is the host time at which the vehicle acknowledged arming.

    `then` is the reference that may take over in flight; None if there is none. `timing` measures how late
    poses arrive in real time; None for a simulated vehicle in this process.
    `last_status` is the newest FC_STATUS logged; None before the first. `deadline_us` is the time at which
    `link` is due.
    """

    def __init__(
        self,
        log: LogWriter,
        client: Client,
        camera: CameraClock,
        reference: Reference,
        arm_us: int,
        *,
        then: Reference | None = None,
        timing: PoseTiming | None = None,
    ) -> None:
        self.last_status: m.FcStatus | None = None
        self._log = log
        self._client = client
        self._clock = client.clock
        self._camera = camera
        self._arm_us = arm_us
        self.deadline_us = arm_us
        self._intervals = IntervalDecoder()
        self._estimate_tick = self._rotors_tick = -1
        self._observer: m.FcObserver | None = None
        self._first = self._flown = _FlownReference(reference)
        self._then = None if then is None else _FlownReference(then)
        self._control_start_us: int | None = None
        self._counts = LinkCounts(client)
        self._timing = timing
        log.display.reference_path(0, self._first.path())
        self._handlers: dict[type, Callable[[Any, int], None]] = {
            m.FcControl: self._control,
            m.FcEstimate: self._estimate,
            m.FcObserver: self._observe,
            m.FcRotors: self._rotors,
            m.FcStatus: self._status,
            m.StatusText: self._text,
        }

    def receive(self, messages: Sequence[Message], now_us: int) -> None:
        """Log newly received messages."""
        handlers = self._handlers
        for message in messages:
            handler = handlers.get(type(message))
            if handler is not None:
                handler(message, now_us - self._arm_us)

    def pose(self, message: m.AttPosMocap, vehicle_us: int, now_us: int) -> None:
        """Log a camera pose that was forwarded with the stamp `vehicle_us` (0: not forwarded)."""
        source_us = message.time_usec
        publish_us = round(source_us - self._camera.offset_us) - self._arm_us
        log_us = now_us - self._arm_us
        p = (message.x, message.y, message.z)
        self._log.pose(Stamps(log_us, publish_us, source_us), vehicle_us, p, message.q)
        self._log.display.pose(log_us, publish_us, p, message.q)

    def link(self, now_us: int) -> None:
        """Log the state of the link if it is due."""
        if now_us < self.deadline_us:
            return
        self.deadline_us += LINK_US * (1 + (now_us - self.deadline_us) // LINK_US)
        codec, clock, counts = self._client.codec, self._clock, self._counts
        sent, received, lost = counts.frames()
        radios, (bytes_sent, bytes_received) = counts.radios(), counts.bytes()
        message = flight_pb2.Link(
            frames_sent=sent,
            frames_received=received,
            frames_lost=lost,
            frames_repeated=codec.repeated,
            bad_bytes=codec.bad_bytes,
            rtt_us=clock.rtt_us,
            clock_offset_us=clock.offset_us,
            clock_offset_sd_us=clock.sd_us,
            camera_offset_us=self._camera.offset_us,
            messages_sent=codec.sent,
            messages_received=codec.received,
            messages_lost=codec.lost,
            rtt_last_us=clock.rtts_us[-1] if clock.rtts_us else 0.0,
            bytes_sent=bytes_sent,
            bytes_received=bytes_received,
            radios=None if radios is None else flight_pb2.Radios(**radios._asdict()),
        )
        log_us = now_us - self._arm_us
        self._log.write(topics.LINK, message, log_us, log_us)
        if self._timing is not None:
            poses, late, worst_us = self._timing.take()
            timing = timing_pb2.Timing(
                poses=poses,
                late_poses=late,
                pose_late_us=worst_us,
                runs_late=self._timing.lateness.running,
                clock_steps=clock.steps,
            )
            self._log.write(topics.HOST_TIMING, timing, log_us, log_us)

    def record_text(self, text: str, now_us: int) -> None:
        """Log a text message of the host."""
        log_us = now_us - self._arm_us
        self._log.text(log_us, log_us, mavlink.MAV_SEVERITY_INFO, text, "host")

    def begin_control(self, control: HostControl, start_us: int, now_us: int) -> None:
        """Log that a controller takes over; the reference starts at `start_us` on the vehicle's clock."""
        self._control_start_us = start_us
        self._first.start_tick = start_us // TICK_US
        entries = {
            "controller": control.name,
            "settings_id": control.settings_id,
            "period_us": str(control.controller.period_us),
            "computing_us": str(control.computing_us),
            "reference_start_us": str(start_us),
        }
        if control.model_id is not None:
            entries["model_id"] = control.model_id
        self._log.add_metadata(HOST_CONTROL, entries)
        self.record_text(f"controller {control.name} takes over", now_us)

    def control_step(self, record: StepRecord, now_us: int) -> None:
        """Log a step of the controller on the host, after `begin_control`."""
        assert self._control_start_us is not None
        step, source_us = record.step, record.t_us + self._control_start_us
        command = step.command
        message = host_control_pb2.HostControl(
            source_us=source_us,
            reference_us=record.t_us,
            outcome=cast(Any, int(step.status)),
            iterations=step.iterations,
            estimate_age_us=record.estimate_age_us,
            act_us=record.act_us,
            rate_cmd_rad_s=() if command is None else command.rate_frd,
            collective_n=() if command is None else (command.collective_n,),
            late_us=record.late_us,
        )
        self._log.write(topics.HOST_CONTROL, message, now_us - self._arm_us, self._publish_us(source_us))

    def _publish_us(self, vehicle_us: int) -> int:
        """Return the host time from arm of a vehicle stamp."""
        return round(vehicle_us - self._clock.offset_us) - self._arm_us

    def _control(self, message: m.FcControl, log_us: int) -> None:
        ignored = self._intervals.ignored
        interval = self._intervals.push(message)
        if self._intervals.ignored != ignored:
            return
        source_us = message.tick * TICK_US
        publish_us = self._publish_us(source_us)
        interval_us, means = 0, None
        if interval is not None:
            interval_us = (interval.end_tick - interval.start_tick) * TICK_US
            means = (*interval.motor_mean, *interval.gyro_mean, *interval.force_mean)
        self._log.control(
            Stamps(log_us, publish_us, source_us),
            message.collective,
            message.rate_cmd,
            message.torque,
            message.rate_integral,
            interval_us,
            means,
            self._observed(message.tick),
        )
        then = self._then
        if then is not None and then.start_tick is not None and message.tick >= then.start_tick:
            if self._flown is not then:
                self._log.display.reference_path(log_us, then.path())
            self._flown = then
        rows = self._flown.at(message.tick)
        for tick, reference_us, flat in rows:
            self._reference(log_us, tick, reference_us, flat)
        if rows and means is not None:
            self._log.display.residual(log_us, publish_us, interval_us, means)

    def _observe(self, message: m.FcObserver, log_us: int) -> None:
        self._observer = message  # logged with the control message of the same tick, which follows

    def _observed(self, tick: int) -> Sequence[float]:
        observer = self._observer
        return observer.disturbance if observer is not None and observer.tick == tick else ()

    def _reference(self, log_us: int, tick: int, reference_us: int, flat: Sequence[float]) -> None:
        source_us = tick * TICK_US
        publish_us = self._publish_us(source_us)
        self._log.reference(Stamps(log_us, publish_us, source_us), self._flown.id, reference_us, flat)
        half = 0.5 * flat[12]
        self._log.display.reference(log_us, publish_us, flat[0:3], (cos(half), 0.0, 0.0, sin(half)))

    def _estimate(self, message: m.FcEstimate, log_us: int) -> None:
        tick = message.tick
        if self._estimate_tick - OVERTAKEN_TICKS < tick <= self._estimate_tick:
            return
        self._estimate_tick = tick
        source_us = tick * TICK_US
        age_us = decode_age(message.mocap_age)
        self._log.estimate(
            Stamps(log_us, self._publish_us(source_us), source_us),
            message.p,
            message.v,
            decode_quaternion(message.q),
            message.rate,
            message.gyro_bias,
            _AGE_UNKNOWN_US if age_us is None else age_us,
        )

    def _rotors(self, message: m.FcRotors, log_us: int) -> None:
        tick = message.tick
        late = self._rotors_tick - OVERTAKEN_TICKS < tick <= self._rotors_tick
        if late or not self._log.holds(topics.FC_ROTORS):
            return
        self._rotors_tick = tick
        source_us = tick * TICK_US
        stamps = Stamps(log_us, self._publish_us(source_us), source_us)
        self._log.rotors(stamps, decode_rotor_speed(message.speed))

    def _status(self, message: m.FcStatus, log_us: int) -> None:
        self.last_status = message
        known = message.reference_tick != m.NO_TICK
        self._follow(message, message.reference_tick if known and message.state in _FLOWN else None)
        source_us = message.tick * TICK_US
        age_us = decode_age(message.mocap_age_max)
        status = flight_pb2.Status(
            source_us=source_us,
            state=cast(Any, message.state),
            failsafe=cast(Any, message.failsafe),
            battery_v=message.battery_mv * 1e-3,
            reference_id=_shown_id(message.reference_id),
            feedforward_id=_shown_id(message.feedforward_id),
            tracking_start_us=message.reference_tick * TICK_US if known else 0,
            loop_max_us=message.loop_us,
            loop_overruns=message.loop_overruns,
            receive_overruns=message.uart_overruns,
            saturated_ticks=message.saturated_ticks,
            flight_ticks=message.flight_ticks,
            poses_used=message.poses_used,
            loop_mean_us=message.loop_mean_us,
            jitter_us=message.jitter_us,
            mocap_age_max_us=_AGE_UNKNOWN_US if age_us is None else age_us,
            bad_bytes=message.bad_bytes,
            conditions=message.conditions,
            action=message.action,
            swap_us=0 if message.swap_tick == m.NO_TICK else message.swap_tick * TICK_US,
            feedforward_faded=message.feedforward_faded,
        )
        self._log.write(topics.FC_STATUS, status, log_us, self._publish_us(source_us))

    def _follow(self, message: m.FcStatus, start_tick: int | None) -> None:
        """Update the start ticks of both references from a status."""
        then = self._then
        if self._control_start_us is not None:
            start_tick = self._control_start_us // TICK_US if message.state == _OFFBOARD else None
        if then is None or bytes(message.reference_id).hex() != then.id:
            self._first.start_tick = start_tick
            if then is not None:
                agreed = message.swap_tick != m.NO_TICK
                then.start_tick = message.swap_tick if agreed else None
        else:
            then.start_tick = start_tick

    def _text(self, message: m.StatusText, log_us: int) -> None:
        self._log.text(log_us, log_us, message.severity, message.text, "vehicle")


class _FlownReference:
    """Flat outputs of a reference at the ticks of control messages.

    Control messages come every STEP_TICKS ticks, so one table for each phase of that step covers nearly all
    of them. Ticks that arrive before the start tick is known wait for it.
    """

    STEP_TICKS = 10
    WAITING = 10

    def __init__(self, reference: Reference) -> None:
        self.id = reference.id
        self.start_tick: int | None = None
        self._reference = reference
        self._waiting: deque[int] = deque(maxlen=self.WAITING)
        self._tables: dict[int, list[list[float]]] = {}

    def path(self) -> list[list[float]]:
        """Return the positions of the whole reference as a viewer draws it, NED."""
        t_us = np.arange(0, self._reference.duration_us + PERIOD_US, PERIOD_US)
        return reference_at(self._reference, t_us)[:, :3].tolist()

    def at(self, tick: int) -> list[tuple[int, int, Sequence[float]]]:
        """Return (tick, us since the start, flat outputs) of this tick and of the ticks that waited."""
        start = self.start_tick
        if start is None:
            self._waiting.append(tick)
            return []
        rows = [self._row(earlier, start) for earlier in self._waiting if earlier >= start]
        self._waiting.clear()
        if tick >= start:
            rows.append(self._row(tick, start))
        return rows

    def _row(self, tick: int, start: int) -> tuple[int, int, Sequence[float]]:
        end_us = self._reference.duration_us
        row, phase = divmod(tick - start, self.STEP_TICKS)
        table = self._tables.get(phase)
        if table is None:
            rows = end_us // (self.STEP_TICKS * TICK_US) + 2
            t_us = (np.arange(rows) * self.STEP_TICKS + phase) * TICK_US
            table = self._tables[phase] = reference_at(self._reference, t_us).tolist()
        return tick, min((tick - start) * TICK_US, end_us), table[min(row, len(table) - 1)]


def _shown_id(first_bytes: Sequence[int]) -> str:
    """Return an id of six bytes as hex, or an empty string if all bytes are zero."""
    data = bytes(first_bytes)
    return data.hex() if any(data) else ""
