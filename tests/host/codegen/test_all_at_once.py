"""The check of a reference in arrays gives the verdict of the vehicle's check, bit by bit."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from trimtab.firmware_model.law.checks import check_reference
from trimtab.firmware_model.law.limits import from_parameters
from trimtab.firmware_model.law.reference_verdict import ReferenceReason
from trimtab.host.codegen.all_at_once import ALL_AT_ONCE
from trimtab.host.plan.snap import optimise_durations
from trimtab.host.plan.table import snap_table, to_reference
from trimtab.protocol.blobs import YawNode
from trimtab.protocol.parameters import DEFAULTS

AIRFRAME, LIMITS = from_parameters(DEFAULTS)


def _reference(rng, seconds_per_leg):
    """A minimum-snap reference through random waypoints, with a heading that moves between its own nodes."""
    waypoints = rng.uniform([-3.0, -3.0, -4.0], [3.0, 3.0, -1.0], (4, 3))
    total_s = 3.0 * seconds_per_leg
    table = snap_table(waypoints, optimise_durations(waypoints, total_s))
    inner = np.sort(rng.choice(np.arange(1, 40), rng.integers(0, 6), replace=False)) * total_s * 2e4
    yaws = [YawNode(0, 0.1, 0.0), *(YawNode(int(t), *rng.normal(0.0, 0.3, 2)) for t in inner)]
    return to_reference(table, [*yaws, YawNode(int(0.9e6 * total_s), 0.0, 0.0)], "0" * 12)


def _compare(nodes, reference, limits):
    """The verdicts agree in every field, with equal bits; returns the verdict."""
    arguments = (nodes, reference.yaw_nodes(), AIRFRAME, limits)
    one_by_one = check_reference(*arguments, origin=reference.origin_ned)
    assert check_reference(*arguments, origin=reference.origin_ned, evaluator=ALL_AT_ONCE) == one_by_one
    return one_by_one


@pytest.mark.parametrize("seed", range(12))
def test_check_in_arrays_equals_the_check_of_single_samples(seed):
    rng = np.random.default_rng(seed)
    reference = _reference(rng, rng.uniform(0.8, 4.0))
    _compare(reference.nodes, reference, LIMITS)
    _compare(reference.nodes[:: len(reference.nodes) - 1], reference, LIMITS)


def test_check_in_arrays_equals_the_check_of_single_samples_at_a_wrong_number():
    rng = np.random.default_rng(0)
    reference = _reference(rng, 3.0)
    for quantity in range(12):
        nodes = list(reference.nodes)
        state = list(nodes[20].state)
        state[quantity] += 40.0
        nodes[20] = nodes[20]._replace(state=tuple(state))
        assert _compare(nodes, reference, LIMITS).reason_code == ReferenceReason.NOT_SMOOTH


@pytest.mark.parametrize(
    ("name", "field"),
    [("speed_m_s", "speed_max_m_s"), ("tilt_deg", "tilt_max_deg"), ("jerk_m_s3", "jerk_max_m_s3")],
)
def test_limit_that_is_reached_exactly_holds_in_arrays_too(name, field):
    """The greatest value of a slow flight as its limit is within it; the next lower float is not."""
    reference = _reference(np.random.default_rng(1), 3.0)
    limits = replace(LIMITS, **{field: 0.0})
    greatest = -_compare(reference.nodes, reference, limits).margins[name]
    assert _compare(reference.nodes, reference, replace(LIMITS, **{field: greatest})).margins[name] == 0.0
    below = replace(LIMITS, **{field: math.nextafter(greatest, 0.0)})
    verdict = _compare(reference.nodes, reference, below)
    assert (verdict.ok, verdict.value) == (False, greatest)
