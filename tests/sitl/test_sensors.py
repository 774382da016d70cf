"""Camera system and inertial sensors: noise, stamps, delays and gaps as set."""

from __future__ import annotations

import math
from itertools import islice

import numpy as np
import pytest

from trimtab.host.vehicle import load_vehicle
from trimtab.sitl.camera_faults import CameraFaults
from trimtab.sitl.draw import draw_world
from trimtab.sitl.sensors import Imu, Mocap, Pose
from trimtab.sitl.world import ImuSettings, MocapSettings, WorldFile

STILL = (1.0, -2.0, -1.5, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0)
NO_RATE = (0.0, 0.0, 0.0)
CLEAN = MocapSettings(position_noise_m=0.0, attitude_noise_deg=0.0, dropout=0.0, delay_jitter_us=0)


def watch(camera: Mocap, seconds: float, pose=lambda t: STILL, rate=NO_RATE) -> list[tuple[int, Pose]]:
    """Every pose with the time at which it could be read."""
    found = []
    for now_us in range(0, round(seconds * 1e6), 1000):
        if now_us >= camera.due_us:
            camera.tick(now_us, pose(now_us * 1e-6), rate)
        found += [(now_us, pose_read) for pose_read in camera.read()]
    return found


def test_camera_noise_has_the_deviation_set() -> None:
    found = watch(Mocap(MocapSettings(dropout=0.0), 0.0, np.random.default_rng(0)), 30.0)
    p = np.array([pose.p_ned for _, pose in found]) - STILL[:3]
    q = np.array([pose.q_ned_frd for _, pose in found])
    assert p.std(axis=0) == pytest.approx([1e-3] * 3, rel=0.06)
    assert p.mean(axis=0) == pytest.approx([0.0] * 3, abs=1e-4)
    assert np.degrees(2 * q[:, 1:].std(axis=0)) == pytest.approx([0.3] * 3, rel=0.06)
    assert np.linalg.norm(q, axis=1) == pytest.approx(np.ones(len(q)), abs=1e-12)


def test_camera_stamps_every_period_and_poses_arrive_after_the_delay() -> None:
    found = watch(Mocap(CLEAN, 0.0, np.random.default_rng(0)), 1.0)
    stamps = [pose.stamp_us for _, pose in found]
    assert stamps == [10_000 * k for k in range(1, 100)]
    assert {now - pose.stamp_us for now, pose in found} == {4000}


@pytest.mark.parametrize("latency_s", [0.0, 0.0153, 0.03])
def test_camera_shows_the_vehicle_as_it_was_before_the_stamp(latency_s: float) -> None:
    def moving(t: float) -> tuple[float, ...]:
        return (2.0 * t, 0.0, -1.0, 2.0, 0.0, 0.0, math.cos(0.25 * t), 0.0, 0.0, math.sin(0.25 * t))

    found = watch(Mocap(CLEAN, latency_s, np.random.default_rng(0)), 3.0, moving, (0.0, 0.0, 0.5))
    ages = [pose.stamp_us * 1e-6 - pose.p_ned[0] / 2.0 for _, pose in found if pose.stamp_us > 50_000]
    turned = [2 * math.atan2(pose.q_ned_frd[3], pose.q_ned_frd[0]) for _, pose in found]
    assert np.mean(ages) == pytest.approx(latency_s, abs=0.02 * latency_s + 1e-9)
    assert max(ages) <= 1.15 * latency_s + 1e-9
    assert turned[-1] == pytest.approx(0.5 * found[-1][1].p_ned[0] / 2.0, abs=1e-6)


def faulty(kind: str, values: dict[str, float]) -> Mocap:
    """Return cameras without noise with one fault."""
    content = {"description": "x", "tolerances": False, "effects": {kind: values}}
    world = draw_world("x", WorldFile.model_validate(content), 0, load_vehicle("research"))
    return Mocap(CLEAN, 0.0, np.random.default_rng(0), faults=CameraFaults.of(world))


def test_camera_that_slips_turns_positions_and_attitudes_from_its_time_after_lift_off() -> None:
    def climbing(t: float) -> tuple[float, ...]:
        return (1.0, 2.0, -t, 0.0, 0.0, -1.0, 1.0, 0.0, 0.0, 0.0)

    cameras = faulty("camera-slip", {"tilt": 0.02, "yaw": 0.03, "at_s": 1.0, "towards": 0.5 * math.pi})
    found = watch(cameras, 3.0, climbing)
    for _, pose in found:
        t = pose.stamp_us * 1e-6
        slipped = t > 1.2  # a height of 0.2 m is lift-off
        dx, dy = (-0.02 * t - 0.03 * 2.0, 0.03 * 1.0) if slipped else (0.0, 0.0)
        assert pose.p_ned[:2] == pytest.approx((1.0 + dx, 2.0 + dy), abs=3e-3)
        turn = (1.0, 0.0, 0.01, 0.015) if slipped else (1.0, 0.0, 0.0, 0.0)
        assert pose.q_ned_frd == pytest.approx(turn, abs=3e-4)


def test_hidden_marker_shifts_and_tilts_poses_on_one_side_of_the_room() -> None:
    def eastward(t: float) -> tuple[float, ...]:
        return (0.3, t - 1.0, -1.0, 0.0, 1.0, 0.0, 1.0, 0.0, 0.0, 0.0)

    cameras = faulty(
        "hidden-marker", {"shift_m": 0.02, "tilt": 0.03, "edge_m": 0.5, "towards": 0.5 * math.pi}
    )
    found = watch(cameras, 2.5, eastward)
    for _, pose in found:
        east = pose.stamp_us * 1e-6 - 1.0
        if abs(east - 0.5) > 0.2:
            inside = east > 0.5
            assert pose.p_ned == pytest.approx((0.3, east + 0.02 * inside, -1.0), abs=1e-4)
            assert pose.q_ned_frd == pytest.approx((1.0, -0.015 * inside, 0.0, 0.0), abs=2e-4)


def test_camera_leaves_out_gaps_and_dropouts() -> None:
    settings = CLEAN.model_copy(update={"gaps_s": ((0.5, 0.25),), "dropout": 0.1})
    stamps = [p.stamp_us for _, p in watch(Mocap(settings, 0.0, np.random.default_rng(0)), 20.0)]
    assert not [s for s in stamps if 500_000 <= s < 750_000]
    assert len(stamps) == pytest.approx(0.9 * 1975, rel=0.03)


def test_imu_errors_have_the_deviation_set_about_a_constant_bias() -> None:
    imu = Imu(ImuSettings(), np.random.default_rng(0))
    rows = np.array(list(islice(imu.errors(), 10_000)))
    assert rows.std(axis=0) == pytest.approx([0.02] * 3 + [0.08] * 3 + [0.005], rel=0.05)
    assert rows.mean(axis=0) == pytest.approx(imu.bias, abs=3e-3)
    assert imu.bias[6] == 0.0


def test_imu_of_another_flight_has_another_bias() -> None:
    biases = [tuple(Imu(ImuSettings(), np.random.default_rng(seed)).bias) for seed in (0, 0, 1)]
    assert biases[0] == biases[1] != biases[2]
