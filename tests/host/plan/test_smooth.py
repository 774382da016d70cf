"""The spline through a solution: exact where it can be, smooth where the nodes are not."""

from __future__ import annotations

import numpy as np
from scipy.integrate import cumulative_simpson

from trimtab.host.plan.smooth import fit
from trimtab.host.plan.snap import optimise_durations
from trimtab.host.plan.table import evaluate, snap_table

REST = np.zeros((2, 3))
ENDS = np.array([[0.5, -0.2, 0.1], [-0.3, 0.0, 0.4]])
WAYPOINTS = np.array([[0.0, 0.0, -1.0], [2.0, 1.0, -1.5], [3.0, -1.0, -2.0], [0.5, 0.0, -1.0]])


def test_fit_to_nodes_of_a_smooth_path_recovers_it() -> None:
    durations = optimise_durations(WAYPOINTS, 4.2)
    table = snap_table(WAYPOINTS, durations)
    counts = np.maximum(4, np.rint(durations / 0.07)).astype(int)
    times = np.concatenate(
        [[0.0], *[table_time + np.arange(1, n + 1) / n * d for table_time, n, d in
                  zip(np.cumsum(durations) - durations, counts, durations, strict=True)]]
    )  # fmt: skip
    inside = np.minimum(times * 1e6, float(table.times_us[-1]))
    p, v, *_ = evaluate(table, inside)
    fitted = fit(times, p, v, np.concatenate([[0], np.cumsum(counts)]), WAYPOINTS, REST)
    at = np.linspace(0.0, float(table.times_us[-1]), 1001)
    for order, tolerance in enumerate((2e-5, 3e-4, 6e-3, 0.25)):
        assert np.abs(evaluate(fitted, at)[order] - evaluate(table, at)[order]).max() < tolerance


def _jerky_path(n: int, duration: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Times, position and velocity of a path whose jerk jumps, and which starts and ends at rest."""
    t = np.linspace(0.0, duration, n)
    jerk = np.where((t < duration / 4) | (t > 3 * duration / 4), 10.0, -10.0)
    a = cumulative_simpson(jerk, x=t, initial=0.0)
    v = cumulative_simpson(a, x=t, initial=0.0)
    return t, cumulative_simpson(v, x=t, initial=0.0), v


def test_fit_to_nodes_with_jumping_jerk_does_not_ring() -> None:
    t, p, v = _jerky_path(4001, 2.0)
    nodes = slice(None, None, 125)  # 62.5 ms apart
    path = np.stack([p, 0.0 * p, 0.0 * p])
    speed = np.stack([v, 0.0 * v, 0.0 * v])
    waypoints = np.array([[0.0, 0.0, 0.0], [p[-1], 0.0, 0.0]])
    count = len(t[nodes])
    table = fit(t[nodes], path[:, nodes], speed[:, nodes], np.array([0, count - 1]), waypoints, REST)
    at = np.linspace(0.0, 2e6, 2001)
    found = evaluate(table, at)
    assert np.abs(found[0][0] - np.interp(at * 1e-6, t, p)).max() < 1e-3
    # Septic pieces through the nodes' own p, v, a, j would overshoot several times; the spline stays near 10.
    assert np.abs(found[3][0]).max() < 16.0


def test_fit_passes_waypoints_and_ends_at_the_velocities_given() -> None:
    rng = np.random.default_rng(0)
    times = np.linspace(0.0, 2.4, 31)
    waypoints = np.array([[0.0, 0.0, -1.0], [1.0, 0.5, -1.2], [2.0, 0.0, -1.0]])
    p = np.stack([np.interp(times, [0.0, 1.2, 2.4], waypoints[:, axis]) for axis in range(3)])
    table = fit(times, p, rng.normal(0.0, 0.1, (3, 31)), np.array([0, 15, 30]), waypoints, ENDS)
    p_at, v_at, a_at, j_at, _ = evaluate(table, np.array([0.0, 1.2e6, 2.4e6]))
    np.testing.assert_allclose(p_at.T, waypoints, atol=1e-9)
    np.testing.assert_allclose(v_at[:, [0, 2]].T, ENDS, atol=1e-9)
    for rest in (a_at, j_at):
        assert np.abs(rest[:, [0, 2]]).max() < 1e-9


def test_fit_to_too_few_nodes_is_determined_by_waypoints_and_ends() -> None:
    times, waypoints = np.array([0.0, 0.1, 0.2]), np.array([[0.0, 0.0, -1.0], [0.1, 0.0, -1.0]])
    p = np.stack([0.5 * times, 0.0 * times, 0.0 * times - 1.0])
    table = fit(times, p, np.zeros((3, 3)), np.array([0, 2]), waypoints, ENDS)
    assert np.isfinite(table.states_ned).all()
    np.testing.assert_allclose(table.states_ned[[0, -1], :3], waypoints, atol=1e-9)
    np.testing.assert_array_equal(table.states_ned[[0, -1], 3:6], ENDS)
