"""The table of invariants: its rows, and the moments that break them."""

import itertools
import math

import pytest

from trimtab.firmware_model.flight.failsafe import CONDITIONS, Action, escalate
from trimtab.firmware_model.flight.invariants import INVARIANTS, Moment, Transition, broken, excess
from trimtab.firmware_model.flight.supervisor import Event, State
from trimtab.protocol.parameters import DEFAULTS

OWNER, OTHER = (255, 190), (42, 191)


def names(**changes):
    return {row.name for row in broken(Moment(parameters=DEFAULTS, **changes))}


def flown(event, after, before=State.HOLD, **changes):
    return {"transitions": (Transition(before, event, after, **changes),)}


def test_rows_have_names_of_their_own_and_finite_bounds():
    assert len({row.name for row in INVARIANTS}) == len(INVARIANTS)
    for row in INVARIANTS:
        assert math.isfinite(row.bound(DEFAULTS))
        assert row.statement.endswith(".")
        assert (row.formula == "none") is (not row.unit)


def test_moment_at_rest_breaks_nothing():
    assert names() == set()


@pytest.mark.parametrize(
    ("row", "changes"),
    [
        ("ceiling", {"state": State.OFFBOARD, "p": (0.0, 0.0, -7.1)}),
        ("walls", {"state": State.HOLD, "p": (0.0, -11.6, -1.0)}),
        ("impact", {"impact_m_s": 1.1}),
        ("impact-attitude", {"impact_m_s": 1.4, "sinking_m_s": 1.4, "attitude": True}),
        ("slide-attitude", {"impact_m_s": 2.6, "sinking_m_s": 0.1, "attitude": True}),
        ("impact-blind", {"impact_m_s": 1.3, "blind": True}),
        ("motors-off", {"rotors_on_before": True, "p": (0.0, 0.0, -0.2)}),
        ("descent", {"state": State.LANDING, "state_s": 31.0}),
        ("link-lost", {"state": State.HOLD, "silent_s": 3.1}),
        ("setpoints-lost", {"state": State.OFFBOARD, "setpoint_s": 0.6}),
        ("hold-ends", {"state": State.HOLD, "entered_by": Event.SETPOINTS_LOST, "state_s": 21.0}),
        ("poses-lost", {"state": State.LANDING, "pose_s": 0.6}),
        (
            "rank",
            {
                "before": State.FAILSAFE,
                "state": State.FAILSAFE,
                "action_before": Action.LEVEL_DESCENT,
                "action": Action.LAND_IN_PLACE,
            },
        ),
        ("modes", flown(Event.DISARM, State.STANDBY)),
        ("owner", flown(Event.HOLD, State.HOLD, by=OTHER, owner=OWNER)),
        ("arming", flown(Event.ARM, State.ARMED, State.STANDBY, failing_checks=1)),
        ("arming", {**flown(Event.ARM, State.ARMED, State.STANDBY), "pose_s": 0.6}),
        ("parameters", {"before": State.HOLD, "state": State.HOLD, "changed_parameters": 1}),
        ("rotors", {"rotors_on": True}),
        ("finite", {"not_finite": 1}),
    ],
)
def test_moment_beyond_a_bound_breaks_its_row_alone(row, changes):
    assert names(**changes) == {row}


@pytest.mark.parametrize(
    "changes",
    [
        {"state": State.OFFBOARD, "p": (0.0, 0.0, -9.0), "poses_true": False},
        {"state": State.FAILSAFE, "p": (0.0, 0.0, -9.0), "released": True},
        {"rotors_on_before": True, "p": (0.0, 0.0, -2.0), "released": True},
        {"impact_m_s": 9.0, "released": True},
        flown(Event.LAND, State.LANDING, by=OTHER, owner=OWNER),
        flown(Event.KILL, State.STANDBY, by=OTHER, owner=OWNER),
    ],
)
def test_exceptions_that_the_conditions_name_break_nothing(changes):
    assert names(**changes) == set()


def test_measure_that_is_not_a_number_breaks_its_row():
    moment = Moment(parameters=DEFAULTS, state=State.HOLD, p=(0.0, 0.0, math.nan))
    assert excess(INVARIANTS[0], moment) == math.inf


def test_escalation_keeps_the_rank_for_every_failsafe():
    for row, action in itertools.product(CONDITIONS, Action):
        after = escalate(action, row)
        assert "rank" not in names(
            before=State.FAILSAFE, state=State.FAILSAFE, action_before=action, action=after
        )
