"""Camera system and inertial sensors: noise, stamps, delays and gaps as set."""

from __future__ import annotations

import math
from itertools import islice

import numpy as np
import pytest

from trimtab.sitl.sensors import Imu, Mocap, Pose
from trimtab.sitl.world import ImuSettings, MocapSettings

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
