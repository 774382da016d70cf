"""The verdict on a reference: every limit, inside the intervals too, and never an exception."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from trimtab.firmware_model.law.checks import check_reference
from trimtab.firmware_model.law.limits import Airframe, Limits, from_parameters
from trimtab.firmware_model.law.reference import septic
from trimtab.firmware_model.law.reference_verdict import ReferenceReason, ReferenceVerdict
from trimtab.protocol.parameters import DEFAULTS
from trimtab.protocol.upload.transfer import MESSAGE_BYTES

AIRFRAME, LIMITS = from_parameters(DEFAULTS)
YAW = [(0, 0.0, 0.0)]
REST = (0.0,) * 9


def _leg(distance=4.0, seconds=4.0, height=1.5, step_us=100_000):
    """Nodes of a flight from rest to rest along north, sampled from one septic; all in one plane."""
    end_us = round(seconds * 1e6)
    ends = ((0.0, 0.0, -height, *REST), (distance, 0.0, -height, *REST))
    nodes = []
    for t_us in range(0, end_us + 1, step_us):
        p, v, a, j, _ = septic(seconds, t_us * 1e-6, *ends)
        nodes.append((t_us, (*p, *v, *a, *j)))
    return nodes


def _with(nodes, k, **changes):
    """The nodes with numbers of node k replaced: p0=..., v2=..."""
    t_us, state = nodes[k]
    state = list(state)
    for name, value in changes.items():
        state[3 * "pvaj".index(name[0]) + int(name[1])] = value
    return [*nodes[:k], (t_us, tuple(state)), *nodes[k + 1 :]]


def _check(nodes, yaw=YAW, limits=LIMITS, **options):
    return check_reference(nodes, yaw, AIRFRAME, limits, **options)


def test_check_of_a_gentle_flight_is_ok_with_margins_to_every_limit():
    verdict = _check(_leg())
    assert verdict.ok
    assert verdict.reason_code == ReferenceReason.NONE
    peak = 35 / 16 * 4.0 / 4.0  # of a septic from rest to rest
    assert verdict.margins["speed_m_s"] == pytest.approx(LIMITS.speed_max_m_s - peak, abs=1e-6)
    assert verdict.margins["geofence_m"] == pytest.approx(1.8, abs=1e-6)
    assert verdict.margins["body_rate_rad_s"] > 0.0
    hover = 0.752 * 9.81 / 4 / 8.5
    assert 0.0 < verdict.margins["thrust_low"] < hover - LIMITS.thrust_headroom[0]
    assert 0.0 < verdict.margins["thrust_high"] < LIMITS.thrust_headroom[1] - hover


@pytest.mark.parametrize(
    ("change", "reason", "margin"),
    [
        ({"speed_max_m_s": 2.0}, ReferenceReason.SPEED, "speed_m_s"),
        ({"tilt_max_deg": 8.0}, ReferenceReason.TILT, "tilt_deg"),
        ({"body_rate_max_rad_s": (6.0, 0.1, 3.0)}, ReferenceReason.BODY_RATE, "body_rate_rad_s"),
        ({"jerk_max_m_s3": 2.0}, ReferenceReason.JERK, "jerk_m_s3"),
        ({"thrust_headroom": (0.2165, 0.65)}, ReferenceReason.THRUST_LOW, "thrust_low"),
        ({"thrust_headroom": (0.08, 0.22)}, ReferenceReason.THRUST_HIGH, "thrust_high"),
        ({"geofence_m": ((-10.0, 3.5), (-10.0, 10.0), (-6.0, 0.3))}, ReferenceReason.GEOFENCE, "geofence_m"),
    ],
)
def test_check_against_a_tighter_limit_names_it(change, reason, margin):
    verdict = _check(_leg(), limits=replace(LIMITS, **change))
    assert not verdict.ok
    assert verdict.reason_code == reason
    assert verdict.margins[margin] < 0.0
    assert sum(value < 0.0 for value in verdict.margins.values()) == 1
    assert 0 <= verdict.node < 41
    assert f"node {verdict.node} at {0.1 * verdict.node:.3f} s: {verdict.text}, at " in verdict.message
    assert verdict.value != verdict.bound


def test_check_names_the_first_node_that_breaks_a_limit():
    """The speed of the one septic from rest to rest passes 2 m/s between two known nodes."""
    nodes = _leg()
    speeds = [math.hypot(*state[3:6]) for _, state in nodes]
    verdict = _check(nodes, limits=replace(LIMITS, speed_max_m_s=2.0))
    assert speeds[verdict.node] <= 2.0 < speeds[verdict.node + 1]
    assert verdict.quantity == "speed"
    assert verdict.value > verdict.bound == 2.0


def test_check_finds_a_violation_strictly_between_nodes():
    """Both ends at rest and within every limit; the septic between them peaks at 35/16 of the mean speed."""
    nodes = [(0, (0.0, 0.0, -1.5, *REST)), (1_000_000, (3.0, 0.0, -1.5, *REST))]
    limits = replace(LIMITS, jerk_max_m_s3=1e4, tilt_max_deg=85.0, body_rate_max_rad_s=(99.0,) * 3)
    limits = replace(limits, thrust_headroom=(0.0, 1.0), speed_max_m_s=5.0)
    verdict = _check(nodes, limits=limits)
    assert (verdict.node, verdict.reason_code) == (0, ReferenceReason.SPEED)
    assert verdict.margins["speed_m_s"] == pytest.approx(5.0 - 35 / 16 * 3.0, abs=0.01)


def test_check_of_nodes_whose_derivatives_all_do_not_fit_refuses_one_of_them():
    """Acceleration that jumps from node to node, as from piecewise-constant thrust, is jerk no node shows."""
    nodes = [(t, (*s[:6], s[6] + (0.5 if k % 4 < 2 else -0.5), *s[7:])) for k, (t, s) in enumerate(_leg())]
    assert all(math.hypot(*state[9:12]) < 10.0 for _, state in nodes)
    verdict = _check([(0, _leg()[0][1]), *nodes[1:-1], (nodes[-1][0], _leg()[-1][1])])
    assert (verdict.reason_code, verdict.quantity) == (ReferenceReason.NOT_SMOOTH, "acceleration")


def test_check_samples_long_pieces_densely():
    nodes = [(0, (0.0, 0.0, -1.5, *REST)), (4_000_000, (4.0, 0.0, -1.5, *REST))]
    coarse = _check(nodes, samples_per_piece=1).margins
    fine = _check(nodes, samples_per_piece=500).margins
    for name, margin in fine.items():
        assert coarse[name] == pytest.approx(margin, abs=2e-3)


def test_check_sees_the_yaw_profile():
    spin = [(0, 0.0, 0.0), (4_000_000, 14.0, 0.0)]
    verdict = _check(_leg(), spin)
    assert (verdict.reason_code, verdict.quantity) == (ReferenceReason.BODY_RATE, "body rate z")
    assert verdict.margins["body_rate_rad_s"] == pytest.approx(3.0 - 1.5 * 14.0 / 4.0, abs=0.01)


def test_check_sees_a_jerk_of_the_heading_between_two_samples():
    quick = [(0, 0.0, 0.0), (2_001_000, 0.0, 0.0), (2_005_000, 0.2, 0.0), (2_009_000, 0.0, 0.0)]
    verdict = _check(_leg(), quick, limits=replace(LIMITS, thrust_headroom=(-999.0, 999.0)))
    assert verdict.reason_code == ReferenceReason.BODY_RATE


def test_check_sees_a_jerk_of_the_heading_in_a_long_piece():
    """2 rad and back within 122 ms, between two of the 512 samples of a hover of 64 s."""
    hover = [(t_us, (0.0, 0.0, -1.5, *REST)) for t_us in (0, 64_000_000)]
    start_us = 8 * 125_000 + 1_000
    spike = [(0, 0.0, 0.0), *((start_us + 61_000 * k, 2.0 * (k == 1), 0.0) for k in range(3))]
    verdict = _check(hover, spike, limits=replace(LIMITS, thrust_headroom=(-99.0, 99.0)))
    assert (verdict.reason_code, verdict.quantity) == (ReferenceReason.BODY_RATE, "body rate z")
    assert verdict.margins["body_rate_rad_s"] == pytest.approx(3.0 - 1.5 * 2.0 / 0.061, abs=0.5)


def test_check_counts_the_torque_of_a_yaw_acceleration():
    """Within the body rate, but the first piece begins at 6 turn / t^2, and two rotors alone pay for it."""
    hover = [(t_us, (0.0, 0.0, -1.5, *REST)) for t_us in (0, 6_000_000)]
    turns = [(60_000 * k, 0.119 * (k % 2), 0.0) for k in range(40)]
    verdict = _check(hover, turns)
    share = 0.752 * 9.81 / 4 / 8.5
    torque_share = 4.3e-3 * 6.0 * 0.119 / 0.06**2 / (4 * 0.022 * 8.5)
    assert verdict.reason_code == ReferenceReason.THRUST_HIGH
    assert verdict.margins["body_rate_rad_s"] > 0.0
    assert verdict.margins["thrust_high"] == pytest.approx(0.65 - share - torque_share, rel=1e-5)
    assert verdict.margins["thrust_low"] == pytest.approx(share - torque_share - 0.08, rel=1e-5)


def test_check_holds_yaw_outside_its_nodes():
    assert _check(_leg(), [(1_000_000, 0.5, 0.0), (1_500_000, 1.0, 0.0)]).ok
    assert _check(_leg(), [(1_000_000, 0.5, 2.0)]).ok  # held throughout: its rate is nowhere flown


@pytest.mark.parametrize(
    ("yaw", "node", "rests"),
    [
        ([(1_000_000, 0.5, 2.0), (1_500_000, 1.0, 0.0)], 9, True),
        ([(1_000_000, 0.5, 0.0), (1_500_000, 1.0, 2.0)], 14, True),
        ([(0, 0.5, 1.0), (1_500_000, 1.0, 0.0)], 0, False),
        ([(0, 0.5, 0.0), (4_000_000, 1.0, 1.0)], 39, False),
        ([(0, 0.5, 0.0), (4_500_000, 3.0, 0.0)], 39, False),
    ],
)
def test_check_refuses_a_yaw_rate_that_jumps_into_or_out_of_a_hold(yaw, node, rests):
    """The flight's own ends are holds only where they are at rest."""
    verdict = _check(_leg(), yaw)
    assert (verdict.reason_code, verdict.quantity) == (ReferenceReason.NOT_AT_REST, "yaw rate")
    assert verdict.node == node
    assert _check(_leg(), yaw, ends_at_rest=False).ok is not rests


def test_check_keeps_the_flight_above_the_floor_whatever_the_geofence():
    """Ends at 0.6 m; between them 0.25 m below the floor, still inside a geofence that ends at 0.3 m."""
    high, low = (0.0, 0.0, -0.6, *REST), (0.0, 0.0, 0.25, *REST)
    nodes = [(0, high), (3_000_000, low), (6_000_000, high)]
    for ends_at_rest in (True, False):
        verdict = _check(nodes, ends_at_rest=ends_at_rest)
        assert (verdict.node, verdict.reason_code, verdict.quantity) == (0, ReferenceReason.TOO_LOW, "height")
        assert verdict.value < verdict.bound == 0.0
        assert verdict.margins["floor_m"] == pytest.approx(-0.25)
        assert verdict.margins["geofence_m"] == pytest.approx(0.05)
    assert _check(nodes, origin=(0.0, 0.0, -0.3)).margins["floor_m"] == pytest.approx(0.05)


def test_check_moves_geofence_and_floor_with_the_origin():
    nodes = [(t, (s[0], s[1], s[2] + 1.5, *s[3:])) for t, s in _leg()]
    assert _check(nodes, origin=(0.0, 0.0, -1.5)).margins == pytest.approx(_check(_leg()).margins)
    verdict = _check(nodes, origin=(8.0, 0.0, -1.5))
    assert (verdict.reason_code, verdict.quantity) == (ReferenceReason.GEOFENCE, "north")
    assert verdict.value > verdict.bound == 10.0


def test_check_of_the_flights_ends_wants_rest_and_height():
    moving = _with(_leg(), 40, v0=0.01)
    assert (_check(moving).reason_code, _check(moving).node) == (ReferenceReason.NOT_AT_REST, 40)
    assert _check(moving, ends_at_rest=False).reason_code != ReferenceReason.NOT_AT_REST
    low = _leg(height=0.4)
    assert (_check(low).reason_code, _check(low).node) == (ReferenceReason.TOO_LOW, 0)
    assert _check(low, ends_at_rest=False).ok
    assert _check(low, limits=replace(LIMITS, end_height_m=0.3)).ok


@pytest.mark.parametrize(
    ("nodes", "yaw", "reason", "node"),
    [
        ([], YAW, ReferenceReason.TOO_FEW_NODES, 0),
        (_leg()[:1], YAW, ReferenceReason.TOO_FEW_NODES, 1),
        (_leg(), [], ReferenceReason.TOO_FEW_NODES, 41),
        (_with(_leg(), 7, j1=math.nan), YAW, ReferenceReason.NOT_FINITE, 7),
        (_with(_leg(), 7, p2=-math.inf), YAW, ReferenceReason.NOT_FINITE, 7),
        (_with(_leg(), 7, v0=1e7), YAW, ReferenceReason.NOT_FINITE, 7),
        (_leg(), [(0, 0.0, 0.0), (10, math.nan, 0.0)], ReferenceReason.NOT_FINITE, 1),
        (_leg()[1:], YAW, ReferenceReason.TIME_ORDER, 0),
        ([*_leg()[:5], *_leg()[4:]], YAW, ReferenceReason.TIME_ORDER, 5),
        (_leg(), [(5, 0.0, 0.0), (5, 0.0, 0.0)], ReferenceReason.TIME_ORDER, 1),
    ],
)
def test_check_of_what_is_no_reference_names_node_and_reason(nodes, yaw, reason, node):
    verdict = _check(nodes, yaw)
    assert not verdict.ok
    assert (verdict.reason_code, verdict.node) == (reason, node)
    assert verdict.margins == {}


WEIRD = st.floats(-1e6, 1e6) | st.sampled_from([0.0, math.nan, math.inf, -0.0, 1e-300, 1e6])


@settings(max_examples=50)
@given(
    st.lists(st.tuples(st.integers(0, 2**32 - 1), st.lists(WEIRD, min_size=12, max_size=12)), max_size=4),
    st.lists(st.tuples(st.integers(0, 2**32 - 1), WEIRD, WEIRD), max_size=3),
    st.booleans(),
)
def test_check_of_any_numbers_returns_a_verdict(nodes, yaw, sort):
    if sort:
        nodes = [(0 if k == 0 else t, s) for k, (t, s) in enumerate(sorted(nodes, key=lambda node: node[0]))]
        yaw = sorted(yaw, key=lambda node: node[0])
    verdict = _check(nodes, yaw, ends_at_rest=False)
    assert isinstance(verdict, ReferenceVerdict)
    assert len(verdict.text.encode()) <= MESSAGE_BYTES
    assert verdict.ok == (verdict.reason_code == ReferenceReason.NONE)


def test_reason_codes_stay_what_they_are():
    assert [reason.value for reason in ReferenceReason] == list(range(15))
    assert (ReferenceReason.NOT_FINITE, ReferenceReason.GEOFENCE, ReferenceReason.THRUST_HIGH) == (2, 6, 12)


@pytest.mark.parametrize(
    "change",
    [{"thrust_headroom": (0.6, 0.1)}, {"geofence_m": ((0.0, 0.0),) * 3}, {"body_rate_max_rad_s": (1.0, 2.0)}],
)
def test_limits_that_contradict_themselves_raise_value_error(change):
    with pytest.raises(ValueError, match=r"not an interval|body rates"):
        replace(LIMITS, **change)


def test_airframe_without_mass_raises_value_error():
    with pytest.raises(ValueError, match="positive"):
        replace(AIRFRAME, mass_kg=0.0)
    assert isinstance(AIRFRAME, Airframe)
    assert isinstance(LIMITS, Limits)
