"""The predicted stopping point against the stop that a landing plans."""

import math
import random

import pytest

from trimtab.firmware_model.flight import braking
from trimtab.firmware_model.flight.envelope import IMPACT_SPEED, Motion, envelope
from trimtab.firmware_model.law.constants import GRAVITY
from trimtab.protocol.parameters import DEFAULTS

ROOM = braking.Room((-0.01, -0.01, -3.0), (0.01, 0.01, 3.0))
"""So narrow that every stop brakes as hard as it can sideways."""


def reach(nodes):
    """How far a stop leads to the north, south, east and west."""
    places = [p for p, _, _ in braking.samples(nodes, 8)]
    return tuple(max(side * p[axis] for p in places) for axis in (0, 1) for side in (1.0, -1.0))


def test_horizontal_stop_uses_its_whole_deceleration_after_a_climb_that_ends_at_once():
    limits = envelope({**DEFAULTS, "LIM_TILT_DEG": 30.0}, 1.0, 4.0)
    state = (*(0.0, 0.0, -1.0), *(5.0, 0.0, -0.1), *(0.0,) * 6)
    nodes = braking.braked(state, limits.brakes, ROOM)
    assert min(a[0] for _, _, a in braking.samples(nodes, 8)) < -0.99 * limits.brakes.sideways


def test_prediction_is_no_shorter_than_the_stop_that_follows():
    rng, errors = random.Random(1), []
    for _ in range(1_500):
        values = {**DEFAULTS, "LIM_TILT_DEG": rng.uniform(20, 60), "LAND_DECEL": rng.uniform(1, 10)}
        limits = envelope(values, 1.0, values["LAND_DECEL"])
        speed, course = rng.uniform(1, 10), rng.uniform(-math.pi, math.pi)
        v = (speed * math.cos(course), speed * math.sin(course), rng.uniform(-4.0, 1.5))
        tilt, thrust, side = math.radians(rng.uniform(0, 50)), rng.uniform(2, 15), course + rng.gauss(0, 0.5)
        level = min(8.0, thrust * math.sin(tilt))
        a = (level * math.cos(side), level * math.sin(side), GRAVITY - thrust * math.cos(tilt))
        motion = Motion(p=(0.0, 0.0, 0.0), v=v, a=a, thrust=thrust, cos_tilt=math.cos(tilt))
        nodes = braking.braked((0.0, 0.0, 0.0, *v, *a[:2], *(0.0,) * 4), limits.brakes, ROOM)
        predicted = limits.sideways(motion, 3.0)
        errors += [far - p for far, p in zip(reach(nodes), predicted, strict=True) if far > 0.5]
    errors.sort()
    assert errors[99 * len(errors) // 100] < 0.6  # m; was above 10
    assert errors[-1] < 1.5


def test_fast_tilt_close_above_the_floor_is_an_impact():
    """While its thrust turns to brake, a vehicle has little lift."""
    limits = envelope(DEFAULTS, 1.0, 4.0)

    def impact(height, tilt_deg, north=2.0, down=0.1):
        tilt = math.radians(tilt_deg)
        a = (GRAVITY * math.tan(tilt), 0.0, 0.0)
        thrust = GRAVITY / math.cos(tilt)
        motion = Motion(
            p=(0.0, 0.0, -height), v=(north, 0.0, down), a=a, thrust=thrust, cos_tilt=math.cos(tilt)
        )
        return limits.impact_speed(motion, height)

    assert impact(0.3, 60.0) > IMPACT_SPEED
    assert impact(0.25, 60.0, down=0.0) > IMPACT_SPEED
    assert impact(0.2, 60.0, down=-0.05) > IMPACT_SPEED
    assert impact(1.0, 60.0) == 0.0
    assert impact(0.3, 10.0, north=1.5) == 0.0


@pytest.mark.parametrize(("speed", "height"), [(2.08, 0.38), (1.6, 0.26)])
def test_sinking_vehicle_is_stopped_while_its_thrust_can_still_build_up(speed, height):
    """The thrust of a stop follows its ramp, behind the rotor lag."""
    motion = Motion(p=(0.0, 0.0, -height), v=(0.0, 0.0, speed), a=(0.0, 0.0, 2.3), thrust=7.5, cos_tilt=1.0)
    assert envelope(DEFAULTS, 1.0, 4.0).impact_speed(motion, height) > IMPACT_SPEED


def test_apex_of_a_climb_that_must_turn_to_brake_is_higher():
    """Torque for the turn takes thrust: 6 m/s up at 45 deg of tilt had led 0.75 m past the ceiling."""
    limits = envelope(DEFAULTS, 1.0, 4.0)
    level = Motion(p=(0.0, 0.0, -2.8), v=(0.0, 0.0, -6.2), a=(0.0, 0.0, 0.5), thrust=9.3, cos_tilt=1.0)
    turning = level._replace(v=(2.4, 4.5, -6.2), a=(4.0, 8.0, 0.5), thrust=13.1, cos_tilt=math.cos(0.785))
    assert limits.apex(turning) > limits.apex(level) + 0.5
