"""Careless setpoints and lost poses in the simulated plant: the ceiling, the walls and the floor hold."""

from __future__ import annotations

import pytest

from trimtab.sitl.studies.envelope.grid import fly_attitude, fly_blind, fly_velocity

NEAR_M, SOON_S = 1.0, 30.0


@pytest.mark.parametrize(
    ("world", "height_m", "thrust", "tilt_deg", "stream_s"),
    [
        ("empty", 1.0, 0.9, 0.0, 1.0),  # climbed to 163 m above the fence before the stop was predicted
        ("rich", 3.0, 1.0, 0.0, 5.0),  # the motors stopped 70 m above the floor
        ("draughty", 0.5, 0.9, 60.0, 5.0),
        ("empty", 6.0, 0.0, 0.0, 1.0),  # hit the floor at 9.5 m/s
    ],
)
def test_attitude_setpoints_stay_below_the_ceiling_and_land_softly(
    world, height_m, thrust, tilt_deg, stream_s
):
    outcome = fly_attitude(world, height_m=height_m, thrust=thrust, tilt_deg=tilt_deg, stream_s=stream_s)
    assert outcome.failsafe
    assert outcome.above_m < NEAR_M
    assert outcome.past_m < NEAR_M
    assert outcome.down_s is not None
    assert outcome.down_s < SOON_S
    assert outcome.motors_off_m < 0.1
    assert outcome.impact_m_s < 1.3


@pytest.mark.parametrize("velocity", [(4.0, 0.0, 0.0), (0.0, 0.0, 2.5), (3.0, -3.0, 1.0)])
def test_velocity_stream_that_stops_ends_at_the_wall_with_a_long_timeout(velocity):
    outcome = fly_velocity("empty", height_m=3.0, velocity=velocity, stream_s=1.0, offboard_s=60.0)
    assert outcome.above_m < 0.5
    assert outcome.past_m < 0.5
    assert outcome.impact_m_s < 1.0


@pytest.mark.parametrize(
    ("world", "height_m", "velocity"),
    [
        ("empty", 6.0, (0.0, 0.0, 0.0)),  # touched at 2.9 m/s when dead reckoning ended after 5 s
        ("draughty", 5.0, (0.0, 0.0, 0.0)),
        ("rich", 2.0, (0.0, 0.0, -2.0)),
    ],
)
def test_descent_without_poses_is_soft(world, height_m, velocity):
    assert_soft(fly_blind(world, height_m=height_m, velocity=velocity))


@pytest.mark.parametrize("seed", [0, 1])
def test_descent_without_poses_allows_for_the_bias_of_the_accelerometer(tmp_path, seed):
    world = tmp_path / "biased.toml"
    world.write_text('description = "biased"\ntolerances = true\n[imu]\naccelerometer_bias_m_s2 = 0.1\n')
    assert_soft(fly_blind(str(world), height_m=5.9, world_seed=seed))


def assert_soft(outcome):
    assert outcome.failsafe
    assert outcome.impact_m_s < 1.2
    assert outcome.motors_off_m < 0.1
    assert outcome.down_s is not None
    assert outcome.down_s < 10.0
