"""Periodic telemetry: FC_CONTROL and FC_ESTIMATE at 100 Hz, FC_STATUS at 10 Hz, HEARTBEAT at 1 Hz.

FC_OBSERVER follows at 100 Hz if OBS_GAIN > 0, at 50 Hz while messages are signed. FC_ROTORS follows if the
motor controllers measure rotor speeds, at 100 Hz, or at 50 Hz beside FC_OBSERVER or with signed messages.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple

from trimtab.firmware_model.flight.flight import UPDATE_TICKS, Flight
from trimtab.firmware_model.flight.supervisor import State
from trimtab.firmware_model.law import step as law
from trimtab.protocol.messages import NO_TICK, FcStatus, Heartbeat, Message, vehicle_heartbeat
from trimtab.protocol.telemetry import (
    TICK_US,
    control_message,
    encode_age,
    estimate_message,
    observer_message,
    rotors_message,
)

STATUS_US = 100_000
HEARTBEAT_US = 1_000_000
_MASK32 = 0xFFFF_FFFF
_MASK16 = 0xFFFF


class LoopTimes(NamedTuple):
    """Timing of several ticks in us: longest and mean duration, greatest deviation from the due time."""

    longest_us: int
    mean_us: int
    jitter_us: int


class OnBoard(NamedTuple):
    """Fields of FC_STATUS that do not concern the flight: blobs, processor load, serial line."""

    vehicle_id: bytes
    reference_id: bytes
    feedforward_id: bytes
    staged_id: bytes
    staged_kind: int
    battery_v: float
    loop: LoopTimes
    late_ticks: int
    uart_overruns: int
    swap_tick: int
    bad_bytes: int


def messages_100_hz(
    flight: Flight, now_us: int, rotor_speed: Callable[[], Sequence[float]] | None = None
) -> Iterator[Message]:
    """Yield the 100 Hz messages of this tick in the order of transmission.

    rotor_speed: measures the rotor speeds, over that at the greatest thrust; None if nothing does.

    FC_OBSERVER follows FC_ESTIMATE, because both fit into one radio frame. It precedes FC_CONTROL, so a host
    has both when FC_CONTROL arrives. Raises ValueError or OverflowError if a value is not finite.
    """
    # A signed FC_OBSERVER does not fit beside FC_ESTIMATE; it gets a frame of its own, half as often.
    # Nor does FC_ROTORS fit beside a signed FC_ESTIMATE, or beside FC_ESTIMATE and FC_OBSERVER.
    signed, observes = flight.monitor.has_key, flight.parameters["OBS_GAIN"] > 0.0
    is_second = now_us // TICK_US % (2 * UPDATE_TICKS) < UPDATE_TICKS
    if observes and (is_second or not signed):
        yield estimate(flight, now_us)
        yield observer(flight, now_us)
        if rotor_speed is not None and is_second:
            yield rotors_message(now_us // TICK_US, speed=rotor_speed())
        yield control(flight, now_us)
    else:
        yield control(flight, now_us)
        yield estimate(flight, now_us)
        if rotor_speed is not None and not observes and (is_second or not signed):
            yield rotors_message(now_us // TICK_US, speed=rotor_speed())


def control(flight: Flight, now_us: int) -> Message:
    """Return FC_CONTROL of this tick. While the rotors are off, commands are 0 and the sums continue.

    Raises ValueError or OverflowError if an output of the control law is not finite.
    """
    outputs, memory = flight.outputs, flight.outputs["memory"]
    on = flight.rotors_on
    return control_message(
        now_us // TICK_US,
        collective_n=outputs["collective_n"][0] if on else 0.0,
        rate_cmd=outputs["rate_cmd"].tolist() if on else _ZERO3,
        torque=outputs["torque"].tolist() if on else _ZERO3,
        motor_sum=memory[law.MOTOR_SUM],
        gyro_sum=memory[law.GYRO_SUM],
        force_sum=memory[law.FORCE_SUM],
        rate_integral=memory[law.RATE_INTEGRAL].tolist(),
    )


def estimate(flight: Flight, now_us: int) -> Message:
    """Return FC_ESTIMATE of this tick. Raises ValueError or OverflowError if a value is not finite."""
    memory = flight.outputs["memory"].tolist()
    bias, (x, y, z) = memory[law.EST_BIAS], flight.gyro
    pose_us = flight.poses.measured_us
    return estimate_message(
        now_us // TICK_US,
        p_ned=memory[law.EST_P],
        v_ned=memory[law.EST_V],
        q_ned_frd=memory[law.EST_Q],
        rate_frd=(x - bias[0], y - bias[1], z - bias[2]),
        mocap_age_us=None if pose_us is None else now_us - pose_us,
        gyro_bias_frd=bias,
    )


def observer(flight: Flight, now_us: int) -> Message:
    """Return FC_OBSERVER of this tick. Raises ValueError or OverflowError if a value is not finite."""
    return observer_message(
        now_us // TICK_US, disturbance_ned=flight.outputs["memory"][law.OBSERVER].tolist()
    )


def status(flight: Flight, now_us: int, board: OnBoard) -> FcStatus:
    """Return FC_STATUS of this tick and reset the quantities that cover the time since the last one."""
    tracking_us, course = flight.tracking_us, flight.course
    battery_mv = 1000.0 * board.battery_v
    return FcStatus(
        tick=now_us // TICK_US & _MASK32,
        state_tick=flight.state_us // TICK_US & _MASK32,
        reference_tick=NO_TICK if tracking_us is None else tracking_us // TICK_US & _MASK32,
        saturated_ticks=flight.saturated_ticks & _MASK32,
        flight_ticks=flight.flight_ticks & _MASK32,
        poses_used=flight.poses.used & _MASK32,
        battery_mv=min(_MASK16, max(0, round(battery_mv))) if math.isfinite(battery_mv) else 0,
        swap_tick=board.swap_tick & _MASK32,
        conditions=flight.conditions,
        loop_us=min(_MASK16, board.loop.longest_us),
        loop_mean_us=min(_MASK16, board.loop.mean_us),
        jitter_us=min(_MASK16, board.loop.jitter_us),
        mocap_age_max=encode_age(flight.poses.oldest_us(now_us)),
        loop_overruns=board.late_ticks & _MASK16,
        uart_overruns=board.uart_overruns & _MASK16,
        bad_bytes=board.bad_bytes & _MASK16,
        state=int(flight.state),
        failsafe=int(flight.failsafe),
        action=int(flight.action),
        staged_kind=board.staged_kind,
        staged_id=board.staged_id,
        reference_id=board.reference_id,
        feedforward_id=board.feedforward_id,
        vehicle_id=board.vehicle_id,
        feedforward_faded=math.ceil(100.0 * (1.0 - flight.feedforward.weight)),
        tracking=int(course.tracking),
        command=0 if course.command is None else int(course.command),
        commander=course.commander or (0, 0),
    )


def heartbeat(flight: Flight) -> Heartbeat:
    """Return the present HEARTBEAT."""
    state = flight.state
    armed = state not in (State.BOOT, State.STANDBY)
    return vehicle_heartbeat(int(state), armed=armed, failsafe=state is State.FAILSAFE)


_ZERO3 = (0.0, 0.0, 0.0)
