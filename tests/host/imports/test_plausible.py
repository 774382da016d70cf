"""A flight read in the wrong axes or units is told from a good one."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.narrowing import not_none
from trimtab.host.imports import ImportFormatError, Recording
from trimtab.host.imports.airborne import airborne
from trimtab.host.imports.frames import Body, World, q_ned_frd, to_frd, to_ned
from trimtab.host.imports.plausible import consistent_parts


def read_as(flight: Any, world: World, body: Body) -> Recording:
    """The numbers of `flight` read as if they were in these axes."""
    t_us = np.round(1e6 * flight.t).astype(np.int64)
    return Recording(
        source="log",
        pose_us=t_us,
        p_ned=to_ned(flight.p, world),
        q_ned_frd=q_ned_frd(flight.turn, world, body),
        unknown=(),
        imu_us=t_us,
        gyro=to_frd(flight.gyro, body),
        specific_force=to_frd(flight.force, body),
        input_us=t_us,
        motor_command=flight.motor,
    )


SPAN_US = (2_000_000, 10_500_000)
AXES = [(world, body) for world in ("ned", "nwu", "enu") for body in ("frd", "flu")]


@pytest.mark.parametrize(("world", "body"), AXES)
def test_flight_in_its_own_axes_agrees_with_itself(
    made_up: Any, foreign: SimpleNamespace, world: World, body: Body
) -> None:
    found = read_as(foreign.in_axes(made_up, world, body), world, body)
    consistent_parts(found, airborne(found))


@pytest.mark.parametrize(("world", "body"), AXES)
@pytest.mark.parametrize(("as_world", "as_body"), AXES)
def test_flight_read_in_other_axes_is_refused_where_it_shows(
    made_up: Any, foreign: SimpleNamespace, world: World, body: Body, as_world: World, as_body: Body
) -> None:
    found = read_as(foreign.in_axes(made_up, world, body), as_world, as_body)
    up = "ned" in (world, as_world) and world != as_world
    if (world, body) == (as_world, as_body):
        consistent_parts(found, (SPAN_US,))
        return
    if body == as_body and not up:
        # East-north-up read as north-west-up is the same flight seen from another side: nothing can show it.
        consistent_parts(found, (SPAN_US,))
        return
    with pytest.raises(ImportFormatError) as caught:
        consistent_parts(found, (SPAN_US,))
    assert "check" in str(caught.value)


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"gyro": 57.3}, "gyro's x axis"),
        ({"gyro": -1.0}, "gyro's y axis"),
        ({"specific_force": 1 / 9.8}, "accelerometer averages"),
        ({"specific_force": -1.0}, "accelerometer averages"),
        ({"p_ned": 1e3}, "acceleration north"),
        ({"pose_us": 1000}, "acceleration"),
    ],
)
def test_value_in_another_unit_is_refused(made_up: Any, changes: dict[str, float], said: str) -> None:
    found = read_as(made_up, "ned", "frd")
    span = SPAN_US
    if "pose_us" in changes:
        found = replace(found, **{name: found.pose_us // 5 for name in ("pose_us", "imu_us", "input_us")})
        span = (SPAN_US[0] // 5, SPAN_US[1] // 5)
    else:
        found = replace(found, **{name: getattr(found, name) * by for name, by in changes.items()})
    with pytest.raises(ImportFormatError, match=said):
        consistent_parts(found, (span,))


def test_positions_mirrored_against_the_attitude_are_refused(made_up: Any) -> None:
    found = read_as(made_up, "ned", "frd")
    with pytest.raises(ImportFormatError, match="acceleration east"):
        consistent_parts(replace(found, p_ned=found.p_ned * [1.0, -1.0, 1.0]), (SPAN_US,))


def test_positions_in_a_room_turned_against_the_attitude_are_refused(made_up: Any) -> None:
    found = read_as(made_up, "ned", "frd")
    quarter = Rotation.from_rotvec([0.0, 0.0, np.pi / 2])
    with pytest.raises(ImportFormatError, match="acceleration north"):
        consistent_parts(replace(found, p_ned=quarter.apply(found.p_ned)), (SPAN_US,))


def test_noise_tilted_markers_and_late_poses_pass(made_up: Any) -> None:
    rng = np.random.default_rng(2)
    found = read_as(made_up, "ned", "frd")
    size = found.p_ned.shape
    bumped = (
        Rotation.from_rotvec(rng.normal(0.0, 0.01, size))
        * Rotation.from_quat(found.q_ned_frd, scalar_first=True)
        * Rotation.from_rotvec([0.07, -0.05, 0.03])
    )
    consistent_parts(
        replace(
            found,
            pose_us=found.pose_us + 20_000,
            p_ned=found.p_ned + rng.normal(0.0, 1e-3, size),
            q_ned_frd=bumped.as_quat(scalar_first=True),
            gyro=not_none(found.gyro) + rng.normal(0.05, 0.05, size),
            specific_force=not_none(found.specific_force) + rng.normal(0.3, 1.0, size),
        ),
        (SPAN_US,),
    )


def test_hover_has_nothing_to_compare_and_passes() -> None:
    t_us = np.arange(0, 5_000_000, 10_000, dtype=np.int64)
    rng = np.random.default_rng(3)
    n = len(t_us)
    consistent_parts(
        Recording(
            source="log",
            pose_us=t_us,
            p_ned=rng.normal(0.0, 1e-3, (n, 3)),
            q_ned_frd=np.tile([1.0, 0.0, 0.0, 0.0], (n, 1)),
            unknown=(),
            imu_us=t_us,
            gyro=rng.normal(0.0, 0.02, (n, 3)),
        ),
        ((0, int(t_us[-1])),),
    )


def test_gap_is_a_gap(made_up: Any) -> None:
    found = read_as(made_up, "ned", "frd")
    kept = (found.pose_us < 4_300_000) | (found.pose_us > 5_300_000)
    dropped = replace(
        found, pose_us=found.pose_us[kept], p_ned=found.p_ned[kept], q_ned_frd=found.q_ned_frd[kept]
    )
    assert consistent_parts(dropped, (SPAN_US,)) == ((SPAN_US,), ())


def test_part_that_contradicts_the_rest_is_cut(made_up: Any) -> None:
    found = read_as(made_up, "ned", "frd")
    lost = found.pose_us > 7_500_000
    p = found.p_ned.copy()
    p[lost] += np.random.default_rng(5).normal(0.0, 0.5, (int(lost.sum()), 3)).cumsum(axis=0)
    (span,), (cut,) = consistent_parts(replace(found, p_ned=p), (SPAN_US,))
    assert span[0] == SPAN_US[0]
    assert 4_000_000 <= span[1] <= 7_600_000
    assert (cut.begin_us, cut.end_us) == (span[1], SPAN_US[1])
    assert "acceleration" in cut.reason


def test_part_that_shows_nothing_is_no_reason_to_trust_the_axes(made_up: Any) -> None:
    found = read_as(made_up, "ned", "frd")
    still = found.pose_us < 6_000_000
    p, q = found.p_ned * [1.0, -1.0, 1.0], found.q_ned_frd.copy()
    p[still], q[still] = [0.0, 0.0, -1.0], [1.0, 0.0, 0.0, 0.0]
    gyro = not_none(found.gyro).copy()
    gyro[still] = 0.0
    with pytest.raises(ImportFormatError, match="acceleration east"):
        consistent_parts(replace(found, p_ned=p, q_ned_frd=q, gyro=gyro, specific_force=None), (SPAN_US,))


def test_noise_of_positions_does_not_hide_that_the_attitude_fits(made_up: Any) -> None:
    found = read_as(made_up, "ned", "frd")
    noisy = found.p_ned + np.random.default_rng(7).normal(0.0, 0.03, found.p_ned.shape)
    assert consistent_parts(replace(found, p_ned=noisy), (SPAN_US,)) == ((SPAN_US,), ())
    with pytest.raises(ImportFormatError, match="acceleration east"):
        consistent_parts(replace(found, p_ned=noisy * [1.0, -1.0, 1.0]), (SPAN_US,))


def test_flight_that_contradicts_itself_is_cut_beside_one_that_shows_the_axes(made_up: Any) -> None:
    found = read_as(made_up, "ned", "frd")
    good, bad = (2_000_000, 6_000_000), (6_500_000, 10_500_000)
    lost = found.pose_us > bad[0]
    p = found.p_ned.copy()
    p[lost] += np.random.default_rng(5).normal(0.0, 0.5, (int(lost.sum()), 3)).cumsum(axis=0)
    parts, (cut,) = consistent_parts(replace(found, p_ned=p), (good, bad))
    assert parts == (good,)
    assert (cut.begin_us, cut.end_us) == bad
    with pytest.raises(ImportFormatError, match="acceleration"):
        consistent_parts(replace(found, p_ned=p), (bad,))
