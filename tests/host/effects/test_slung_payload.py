"""Slung payload: what the line, the floor and the air do to vehicle and payload, against numbers by hand."""

from __future__ import annotations

import numpy as np
import pytest

from tests.host.effects.test_effects import EFFECTS, VEHICLE, level
from trimtab.firmware_model.law.constants import GRAVITY
from trimtab.firmware_model.law.ops import FLOAT
from trimtab.host.models import slots
from trimtab.host.models.dynamics import rigid_body

PAYLOAD = EFFECTS["slung-payload"]
RATIO, LENGTH = 0.1, 0.6
HIGH = (0.0, 0.0, -3.0)
HELD = (0.0, 0.0, 0.0)
NAMES = ("ratio", "length_m", "damping", "tension_share")


def motion(
    offset: tuple[float, float, float] = (0.0, 0.0, 0.0),
    speed: tuple[float, float, float] = (0.0, 0.0, 0.0),
    *,
    p_ned: tuple[float, float, float] = HIGH,
    lift: float = 1.0 + RATIO,
    **values: float,
) -> tuple[np.ndarray, np.ndarray]:
    """Return what the payload adds to the acceleration of the vehicle, and its own acceleration, NED.

    offset, speed: of the payload, from where it would hang. The vehicle is at rest, and held there. lift:
    thrust over the weight of the vehicle.
    """
    given = {"ratio": RATIO, "length_m": LENGTH, "damping": 0.05, "tension_share": 0.5, **values}
    parts = [(PAYLOAD, tuple(given[name] for name in NAMES))]
    x = level()
    x[0:3] = list(p_ned)
    x[12:16] = [lift * VEHICLE.mass_kg * GRAVITY / 4.0] * 4
    memory = [*offset, *speed]
    body = np.array(rigid_body(FLOAT, VEHICLE, parts, x, memory=memory)[3:6])
    alone = np.array(rigid_body(FLOAT, VEHICLE, [], x)[3:6])
    return body - alone, np.array(slots.memory_rates(FLOAT, VEHICLE, parts, x, memory, HELD)[3:6])


def test_payload_at_rest_weighs_on_a_vehicle_that_hovers_with_it():
    pull, acceleration = motion()
    np.testing.assert_allclose(pull, [0.0, 0.0, RATIO * GRAVITY], atol=1e-4)
    np.testing.assert_allclose(acceleration, 0.0, atol=1e-3)


@pytest.mark.parametrize("tension_share", [0.0, 0.5, 1.0])
def test_pull_on_the_vehicle_is_that_on_the_payload_reversed(tension_share: float):
    pull, acceleration = motion((0.2, -0.1, -0.03), (0.5, 0.7, -0.2), tension_share=tension_share)
    assert abs(pull[:2]).min() > 0.01
    speed = np.array([0.5, 0.7, -0.2])
    air = -0.023 * np.linalg.norm(speed) * speed
    weight = np.array([0.0, 0.0, GRAVITY])
    np.testing.assert_allclose(pull / RATIO, weight + air - acceleration, rtol=1e-4, atol=1e-5)


def test_damping_grows_with_the_tension_by_its_share():
    def braking(lift: float, tension_share: float) -> float:
        damped, free = (
            motion(speed=(0.3, 0.0, 0.0), lift=lift, damping=d, tension_share=tension_share)[1][0]
            for d in (0.1, 0.0)
        )
        return float(damped - free)

    natural = np.sqrt(GRAVITY / LENGTH)
    hover, double = 1.0 + RATIO, 2.0 * (1.0 + RATIO)
    assert braking(hover, 0.0) == pytest.approx(-0.2 * natural * 0.3, rel=1e-6)
    assert braking(double, 0.0) == pytest.approx(braking(hover, 0.0), rel=1e-6)
    assert braking(double, 1.0) == pytest.approx(2.0 * braking(hover, 0.0), rel=0.02)  # and |w|^2 / l
    assert braking(double, 0.5) == pytest.approx(1.5 * braking(hover, 0.0), rel=0.02)


def test_slack_line_pulls_nothing():
    pull, acceleration = motion((0.0, 0.0, -0.1))
    np.testing.assert_array_equal(pull, 0.0)
    np.testing.assert_allclose(acceleration, [0.0, 0.0, GRAVITY], atol=1e-9)


def test_payload_on_the_floor_is_not_carried():
    low = (0.0, 0.0, -0.4)
    sunk = GRAVITY / 400.0  # where a floor of 20 1/s holds the payload
    pull, acceleration = motion((0.0, 0.0, -0.2 + sunk), p_ned=low)
    np.testing.assert_array_equal(pull, 0.0)
    np.testing.assert_allclose(acceleration, 0.0, atol=1e-9)


@pytest.mark.parametrize(("height", "raised"), [(2.0, 0.0), (0.4, 0.2), (0.0, 0.6)])
def test_payload_starts_below_the_vehicle_or_on_the_floor(height: float, raised: float):
    x = level()
    x[0:3] = [1.0, 2.0, -height]
    parts = [(PAYLOAD, (RATIO, LENGTH, 0.05, 0.5))]
    memory = slots.memory_at_rest(FLOAT, VEHICLE, parts, x)
    np.testing.assert_allclose(memory, [0.0, 0.0, -raised, 0.0, 0.0, 0.0], atol=1e-12)
    assert np.isfinite(slots.memory_rates(FLOAT, VEHICLE, parts, x, memory, HELD)).all()


def test_payload_falls_behind_a_vehicle_that_accelerates():
    parts = [(PAYLOAD, (RATIO, LENGTH, 0.05, 0.5))]
    x = level()
    x[0:3] = list(HIGH)
    a_ned = (1.0, -2.0, 0.5)
    moved, held = (slots.memory_rates(FLOAT, VEHICLE, parts, x, [0.0] * 6, a) for a in (a_ned, HELD))
    np.testing.assert_allclose(np.subtract(moved, held), [0.0, 0.0, 0.0, -1.0, 2.0, -0.5], atol=1e-12)
