"""Node tables: rounded times, exact subdivision, the blob's rounding, headings."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.interpolate import BPoly

from trimtab.host.plan.snap import solve_snap
from trimtab.host.plan.table import (
    Table,
    evaluate,
    flat_states,
    from_reference,
    knot_times,
    round_times,
    snap_table,
    to_reference,
    yaw_at,
)
from trimtab.host.vehicle import load_vehicle
from trimtab.protocol.blobs import YawNode

WAYPOINTS = np.array([[0.0, 0.0, -1.0], [2.0, 1.0, -1.5], [3.0, -1.0, -2.0], [0.5, 0.0, -1.0]])
DURATIONS = np.array([1.3333333, 0.9, 1.41])


def test_knot_times_hold_every_waypoint_about_evenly_spaced() -> None:
    waypoints = np.array([0, 1_333_333, 1_360_000, 3_000_001])
    knots = knot_times(waypoints)
    assert set(waypoints) <= set(knots)
    steps = np.diff(knots)
    legs = np.searchsorted(waypoints, knots[:-1], side="right") - 1
    assert (steps[legs != 1] >= 50_000).all()
    assert steps.max() <= 150_000
    assert list(steps[legs == 1]) == [26_667]


def test_knot_times_with_a_cap_make_no_more_pieces() -> None:
    knots = knot_times(np.array([0, 1_000_000, 2_000_000]), most=np.array([4, 20]))
    assert np.searchsorted(knots, 1_000_000) == 4
    assert len(knots) == 4 + 10 + 1


def test_round_times_falling_together_raises() -> None:
    with pytest.raises(ValueError, match="microsecond"):
        round_times(np.array([0.0, 1e-7]))


def test_snap_table_between_nodes_is_the_spline_itself() -> None:
    table = snap_table(WAYPOINTS, DURATIONS)
    times = round_times(np.concatenate([[0.0], np.cumsum(DURATIONS)]))
    spline = solve_snap(WAYPOINTS, np.diff(times) * 1e-6)
    oracle = BPoly.from_derivatives(spline.times_s, spline.ends_ned)
    at = np.linspace(0.0, float(times[-1]), 777)
    for order, values in enumerate(evaluate(table, at)):
        expected = oracle.derivative(order)(at * 1e-6) if order else oracle(at * 1e-6)
        np.testing.assert_allclose(values.T, expected, atol=1e-8 * 10.0**order)


def test_table_as_reference_keeps_waypoints_and_jerk() -> None:
    table = snap_table(WAYPOINTS + np.array([812.0, -430.0, -2.0]), DURATIONS)
    reference = to_reference(table, [YawNode(0, 0.3, 0.0)], "0123456789ab")
    flown = from_reference(reference)
    at = np.linspace(0.0, float(table.times_us[-1]), 2001)
    exact, rounded = evaluate(table, at), evaluate(flown, at)
    assert np.abs(exact[0] - rounded[0]).max() < 1e-6  # the origin moves along: no float32 of 812 m
    assert np.abs(exact[3] - rounded[3]).max() < 0.02
    assert reference.nodes[0].t_us == 0
    assert reference.duration_us == table.times_us[-1]


def test_yaw_outside_its_nodes_is_held() -> None:
    yaws = [YawNode(100_000, 0.5, 0.0), YawNode(600_000, 1.5, 1.0), YawNode(1_100_000, 1.0, 0.0)]
    yaw, rate = yaw_at(yaws, np.array([0.0, 100_000.0, 600_000.0, 2_000_000.0]))
    np.testing.assert_allclose(yaw, [0.5, 0.5, 1.5, 1.0], atol=1e-7)
    np.testing.assert_allclose(rate, [0.0, 0.0, 1.0, 0.0], atol=1e-7)


def test_flat_states_integrate_to_themselves() -> None:
    # Velocity, Euler rates and the vehicle's own equations must agree with finite differences along the path.
    from trimtab.host.codegen import NUMPY
    from trimtab.host.models.dynamics import rigid_body

    vehicle = load_vehicle("research")
    table = snap_table(WAYPOINTS, DURATIONS)
    yaws = [YawNode(0, 0.0, 0.0), YawNode(int(table.times_us[-1]), 1.0, 0.0)]
    at = np.linspace(2e5, float(table.times_us[-1]) - 2e5, 50)
    x = flat_states(vehicle, table, yaws, at)
    step_us = 50.0
    after = flat_states(vehicle, table, yaws, at + step_us)
    before = flat_states(vehicle, table, yaws, at - step_us)
    slopes = (after - before)[:12] / (2e-6 * step_us)
    expected = np.array(rigid_body(NUMPY, vehicle, (), list(x)))
    np.testing.assert_allclose(slopes[:9], expected[:9], atol=2e-4)
    # Snap jumps nowhere on a min-snap spline, but yaw acceleration is left out of the flat torque.
    np.testing.assert_allclose(slopes[9:11], expected[9:11], atol=2e-2)


def test_table_of_uneven_parts_raises() -> None:
    with pytest.raises(ValueError, match="rows of 12"):
        Table(times_us=np.array([0, 1]), states_ned=np.zeros((3, 12)))
