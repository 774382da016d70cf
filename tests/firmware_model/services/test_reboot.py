"""MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN: a reboot is planned while disarmed only."""

from __future__ import annotations

import math

import pytest

from trimtab.firmware_model.clock import NEVER_US
from trimtab.firmware_model.flight.supervisor import State
from trimtab.firmware_model.mcu.flight_mcu import REBOOT_DELAY_US
from trimtab.protocol import messages as m
from trimtab.protocol.messages import mavlink

REBOOT, ARM = mavlink.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN, mavlink.MAV_CMD_COMPONENT_ARM_DISARM


def result_of(session, number, *parameters):
    """What the vehicle answers to a command."""
    session.command(number, *parameters)
    session.run(0.1)
    acks = [message for message in session.inbox if isinstance(message, m.CommandAck)]
    assert acks[-1].command == number
    return acks[-1].result


def test_reboot_in_standby_is_accepted_and_planned_after_its_acknowledgement(make_session):
    session = make_session()
    session.run(1.0)
    before_us = session.now_us
    assert result_of(session, REBOOT, 1.0) == mavlink.MAV_RESULT_ACCEPTED
    assert before_us < session.flight.reboot_us - REBOOT_DELAY_US <= session.now_us
    assert "rebooting" in session.texts()


def test_reboot_while_armed_is_refused_with_a_text(make_session):
    session = make_session()
    session.run(1.0)
    assert result_of(session, ARM, 1.0) == mavlink.MAV_RESULT_ACCEPTED
    assert result_of(session, REBOOT, 1.0) == mavlink.MAV_RESULT_TEMPORARILY_REJECTED
    assert session.flight.reboot_us == NEVER_US
    assert "reboot refused: armed" in session.texts()


def test_arming_calls_a_planned_reboot_off(make_session):
    session = make_session()
    session.run(1.0)
    result_of(session, REBOOT, 1.0)
    assert result_of(session, ARM, 1.0) == mavlink.MAV_RESULT_ACCEPTED
    assert session.flight.state is State.ARMED
    assert session.flight.reboot_us == NEVER_US


@pytest.mark.parametrize(
    ("number", "result"),
    [
        (0.0, mavlink.MAV_RESULT_ACCEPTED),
        (2.0, mavlink.MAV_RESULT_UNSUPPORTED),
        (math.nan, mavlink.MAV_RESULT_UNSUPPORTED),
    ],
)
def test_other_numbers_reboot_nothing(make_session, number, result):
    session = make_session()
    session.run(1.0)
    assert result_of(session, REBOOT, number) == result
    assert session.flight.reboot_us == NEVER_US
