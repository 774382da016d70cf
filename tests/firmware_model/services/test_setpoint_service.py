"""Setpoint messages: what of them is followed, what is refused and said; modes by command."""

from __future__ import annotations

import math

import pytest

from trimtab.firmware_model.flight.setpoints import AttitudeTarget, PositionTarget
from trimtab.firmware_model.flight.supervisor import State
from trimtab.firmware_model.services.setpoint_service import NOT_FINITE, SetpointService
from trimtab.protocol import messages as m
from trimtab.protocol.codec import Codec
from trimtab.protocol.messages import mavlink

NAN = math.nan
NO_P, NO_V, NO_A, NO_YAW, NO_YAW_RATE = 0b111, 0b111_000, 0b111_000_000, 1 << 10, 1 << 11
NO_RATES, NO_THRUST, NO_ATTITUDE = 0b111, 64, 128
LOCAL, OFFSET, BODY = 1, 7, 8
Triple = tuple[float, float, float]
REST: Triple = (0.0, 0.0, 0.0)


class Sink:
    def __init__(self):
        self.targets, self.texts = [], []
        self.service = SetpointService(
            take=lambda target, now_us: self.targets.append(target),
            text=lambda severity, text: self.texts.append(text),
        )

    def position(
        self,
        mask: int,
        *,
        frame: int = LOCAL,
        p: Triple = (1.0, 2.0, -3.0),
        v: Triple = (0.1, 0.2, 0.3),
        a: Triple = (4.0, 5.0, 6.0),
    ) -> None:
        message = m.SetPositionTarget(0, 1, 1, frame, mask, *p, *v, *a, 0.7, 0.8)
        self.service.position(message, 0)

    def attitude(
        self,
        mask: int,
        *,
        q: tuple[float, ...] = (1.0, 0.0, 0.0, 0.0),
        rate: Triple = (0.1, 0.2, 0.3),
        thrust: float = 0.4,
    ) -> None:
        self.service.attitude(m.SetAttitudeTarget(0, 1, 1, mask, list(q), *rate, thrust), 0)


@pytest.fixture
def sink():
    return Sink()


NONE3 = (None, None, None)


@pytest.mark.parametrize(
    ("mask", "frame", "target"),
    [
        (NO_V | NO_A | NO_YAW_RATE, LOCAL, PositionTarget(p=(1.0, 2.0, -3.0), v=NONE3, yaw=0.7)),
        (NO_P | NO_A | NO_YAW_RATE, LOCAL, PositionTarget(p=NONE3, v=(0.1, 0.2, 0.3), yaw=0.7)),
        (NO_P | NO_A | NO_YAW_RATE, OFFSET, PositionTarget(p=NONE3, v=(0.1, 0.2, 0.3), yaw=0.7)),
        (NO_P | NO_A | NO_YAW, BODY, PositionTarget(p=NONE3, v=(0.1, 0.2, 0.3), yaw_rate=0.8, ahead=True)),
        (
            NO_YAW | NO_YAW_RATE,
            LOCAL,
            PositionTarget(p=(1.0, 2.0, -3.0), v=(0.1, 0.2, 0.3), a=(4.0, 5.0, 6.0)),
        ),
        (
            0b011 | 0b100_000 | NO_A | NO_YAW | NO_YAW_RATE,
            LOCAL,
            PositionTarget(p=(None, None, -3.0), v=(0.1, 0.2, None)),
        ),
    ],
)
def test_position_mask_and_frame_say_what_is_followed(sink, mask, frame, target):
    sink.position(mask, frame=frame)
    assert sink.targets == [target]
    assert sink.texts == []


@pytest.mark.parametrize(
    ("mask", "frame", "text"),
    [
        (NO_V | NO_A, 5, "setpoint refused: frame 5 not known"),
        (512, LOCAL, "setpoint refused: forces are not followed"),
        (NO_V | NO_A, OFFSET, "setpoint refused: position in LOCAL_NED only"),
        (NO_V | NO_A, BODY, "setpoint refused: position in LOCAL_NED only"),
        (NO_P | NO_V, LOCAL, "setpoint refused: axis without position, velocity"),
    ],
)
def test_position_that_is_not_supported_is_refused_and_said_once(sink, mask, frame, text):
    for _ in range(3):
        sink.position(mask, frame=frame)
    assert sink.targets == []
    assert sink.texts == [text]
    assert len(text) <= 50


def test_force_bit_beside_an_ignored_acceleration_says_nothing(sink):
    """Masks with all bits set but the position's are common."""
    sink.position(0b1111_1111_1000)
    assert sink.targets == [PositionTarget(p=(1.0, 2.0, -3.0), v=NONE3)]
    assert sink.texts == []


def test_numbers_that_are_not_finite_are_left_out_and_said_once(sink):
    mask = NO_A | NO_YAW | NO_YAW_RATE
    sink.position(mask, v=(NAN, math.inf, 0.3))
    assert sink.targets == [PositionTarget(p=(1.0, 2.0, -3.0), v=(None, None, 0.3))]
    sink.position(mask, p=(NAN, 2.0, -3.0), v=(NAN, 0.2, 0.3))
    assert len(sink.targets) == 1
    assert sink.texts == [NOT_FINITE, "setpoint refused: axis without position, velocity"]


def test_attitude_and_rate(sink):
    sink.attitude(NO_ATTITUDE, q=(NAN,) * 4)
    sink.attitude(NO_RATES, q=(0.99, 0.0, 0.0, 0.0), thrust=1.5)
    sink.attitude(0b011)
    assert [type(target) for target in sink.targets] == [AttitudeTarget] * 3
    assert [(target.thrust, target.rate, target.q) for target in sink.targets] == [
        (pytest.approx(0.4), pytest.approx((0.1, 0.2, 0.3)), None),
        (1.0, (0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0)),
        (pytest.approx(0.4), pytest.approx((0.0, 0.0, 0.3)), (1.0, 0.0, 0.0, 0.0)),
    ]
    assert sink.texts == []


@pytest.mark.parametrize(
    ("mask", "changes", "text"),
    [
        (NO_RATES | NO_THRUST, {}, "setpoint refused: attitude or rate without thrust"),
        (NO_RATES, {"thrust": NAN}, "setpoint refused: attitude or rate without thrust"),
        (NO_RATES, {"q": (0.5, 0.0, 0.0, 0.0)}, "setpoint refused: no unit quaternion"),
        (NO_RATES, {"q": (NAN, 0.0, 0.0, 0.0)}, "setpoint refused: no unit quaternion"),
        (NO_ATTITUDE | 0b100, {}, "setpoint refused: body rate not whole"),
        (NO_ATTITUDE, {"rate": (NAN, 0.0, 0.0)}, "setpoint refused: body rate not whole"),
    ],
)
def test_attitude_that_is_not_supported_is_refused_and_said_once(sink, mask, changes, text):
    for _ in range(2):
        sink.attitude(mask, **changes)
    assert sink.targets == []
    assert [told for told in sink.texts if told != NOT_FINITE] == [text]


# Through bytes, radios and the flight processor.


def acknowledged(session):
    ack = session.received(m.CommandAck)[-1]
    return ack.command, ack.result


def ask(session, number, *parameters):
    session.command(number, *parameters)
    session.run(0.1)
    return acknowledged(session)


def square(session, *, seconds, height=1.2):
    mask = NO_V | NO_A | NO_YAW_RATE
    for x, y in ((1.0, 0.0), (1.0, 1.0), (0.0, 1.0), (0.0, 0.0)):
        for _ in range(round(20 * seconds)):
            session.send(m.SetPositionTarget(0, 1, 1, LOCAL, mask, x, y, -height, *REST, *REST, 0.0, 0.0))
            session.run(0.05)
        assert math.dist(session.body.p, (x, y, -height)) < 0.05


def test_session_of_raw_messages_takes_off_flies_a_square_by_setpoints_and_lands(make_session):
    session = make_session()
    session.run(1.0)
    accepted, not_now = mavlink.MAV_RESULT_ACCEPTED, mavlink.MAV_RESULT_TEMPORARILY_REJECTED
    assert ask(session, 400, 1.0) == (400, accepted)
    assert ask(session, 22, 0, 0, 0, 0, 0, 0, 1.2) == (22, accepted)
    session.run_to(State.HOLD)
    assert ask(session, 176, 129.0, 6.0) == (176, not_now)  # nothing is streamed yet
    assert "offboard refused: no setpoints: stream them first" in session.texts()
    session.send(m.SetPositionTarget(0, 1, 1, LOCAL, NO_V | NO_A, 0.0, 0.0, -1.2, *(0.0,) * 8))
    session.run(0.1)
    assert ask(session, 176, 129.0, 6.0) == (176, accepted)
    assert session.flight.state is State.OFFBOARD
    square(session, seconds=2.5)
    beat = session.received(m.Heartbeat)[-1]
    assert beat.custom_mode & 0xF == mavlink.TRIMTAB_STATE_OFFBOARD
    assert beat.custom_mode >> 16 == 6  # PX4's main mode
    assert ask(session, 176, 1.0, 4.0, 3.0) == (176, accepted)
    assert session.flight.state is State.HOLD
    assert ask(session, 176, 1.0, 4.0, 6.0) == (176, accepted)
    assert session.flight.state is State.LANDING
    session.run_to(State.STANDBY)
    assert session.flight.flight.failsafe == 0


def test_mode_6_of_arducopter_starts_no_offboard_and_mode_9_lands(make_session):
    """mavutil takes the vehicle for an ArduCopter: RTL is 6, PX4's offboard, and LAND is 9."""
    session = make_session()
    accepted, not_now = mavlink.MAV_RESULT_ACCEPTED, mavlink.MAV_RESULT_TEMPORARILY_REJECTED
    other, session.host = session.host, Codec(255, 230)  # MAVProxy
    session.run(1.0)
    setpoint = m.SetPositionTarget(0, 1, 1, LOCAL, NO_V | NO_A, 0.0, 0.0, -1.2, *(0.0,) * 8)
    session.port.write(other.encode(setpoint), session.now_us)
    session.run(0.1)
    session.command(400, 1.0)
    session.run_to(State.ARMED)
    assert ask(session, 22, 0, 0, 0, 0, 0, 0, 1.2) == (22, accepted)
    session.run_to(State.HOLD)
    assert ask(session, 176, 1.0, 6.0) == (176, not_now)
    assert "no setpoints of yours" in " ".join(session.texts())
    assert session.flight.state is State.HOLD
    assert ask(session, 176, 1.0, 9.0) == (176, accepted)
    assert session.flight.state is State.LANDING


@pytest.mark.parametrize("parameters", [(1.0, 4.0, 4.0), (1.0, 3.0), (0.0, 6.0), (NAN, 6.0), (1.0, NAN)])
def test_modes_that_are_not_known_are_unsupported(make_session, parameters):
    session = make_session()
    session.run(0.5)
    assert ask(session, 176, *parameters) == (176, mavlink.MAV_RESULT_UNSUPPORTED)


@pytest.mark.parametrize(("height", "reached"), [(NAN, 1.0), (0.0, 1.0), (0.3, 0.3), (0.6, 0.6)])
def test_takeoff_height(make_session, height, reached):
    session = make_session()
    session.run(1.0)
    ask(session, 400, 1.0)
    assert ask(session, 22, 0, 0, 0, 0, 0, 0, height) == (22, mavlink.MAV_RESULT_ACCEPTED)
    session.run_to(State.HOLD)
    assert session.body.p[2] == pytest.approx(-reached, abs=0.02)


@pytest.mark.parametrize("height", [-1.0, 0.001, 0.29, math.inf])
def test_takeoff_height_that_is_none_is_denied(make_session, height):
    session = make_session()
    session.run(1.0)
    ask(session, 400, 1.0)
    assert ask(session, 22, 0, 0, 0, 0, 0, 0, height) == (22, mavlink.MAV_RESULT_DENIED)
    assert session.flight.state is State.ARMED


def test_takeoff_under_a_fence_that_is_too_low_is_refused_with_a_text(make_session):
    session = make_session(parameters={"FENCE_D_MIN": -0.25})
    session.run(1.0)
    ask(session, 400, 1.0)
    refused = (22, mavlink.MAV_RESULT_TEMPORARILY_REJECTED)
    assert ask(session, 22, 0, 0, 0, 0, 0, 0, NAN) == refused
    assert ask(session, 22, 0, 0, 0, 0, 0, 0, 2.0) == refused
    assert "takeoff refused: fence less than 0.3 m above" in session.texts()
    assert session.flight.state is State.ARMED


def test_arm_command_without_a_number_is_denied(make_session):
    session = make_session()
    session.run(1.0)
    session.command(400, NAN, float(m.FORCE))
    session.run(0.1)
    assert acknowledged(session) == (400, mavlink.MAV_RESULT_DENIED)
