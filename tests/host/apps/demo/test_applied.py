"""What of a traced model goes on board."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from trimtab.host.apps.demo.applied import feedforward_of, to_apply, voltage_ratio
from trimtab.host.effects import load_effects
from trimtab.host.models.model import Model
from trimtab.host.vehicle import Vehicle

EFFECTS = load_effects()


def model(vehicle: Vehicle, **effects: Any) -> Model:
    named = {name.replace("_", "-"): values for name, values in effects.items()}
    return Model(vehicle_id=vehicle.id, vehicle_name=vehicle.name, effects=named)


def test_feedforward_holds_the_thrust_that_is_left_at_the_expected_voltage(vehicle: Vehicle) -> None:
    traced = model(vehicle, thrust_gain={"gain": 1.088}, battery_sag={"exponent": 1.8})
    found = feedforward_of(traced, vehicle, EFFECTS, 0.92)
    assert found is not None
    assert found.block is not None
    assert found.block[0] == pytest.approx(1.088 * 0.92**1.8)
    assert found.model_id == traced.id


def test_feedforward_of_what_the_law_cannot_make_up_for_is_none(vehicle: Vehicle) -> None:
    traced = model(vehicle, motor_lag={"extra_s": 0.02}, com_offset={"x": 0.004, "y": 0.0})
    assert feedforward_of(traced, vehicle, EFFECTS, 0.92) is None


def test_voltage_ratio_is_the_mean_over_flights_of_their_tracking_phases(vehicle: Vehicle) -> None:
    full_v = vehicle.battery.full_v

    def flight(volts: list[float]) -> Any:
        battery = SimpleNamespace(t_us=np.array([0, 10, 20, 30]), battery_v=np.array(volts) * full_v)
        return SimpleNamespace(vehicle=vehicle, battery=battery, tracking=(10, 20))

    flights = [flight([1.0, 0.98, 0.96, 0.9]), flight([0.9, 0.9, 0.88, 0.8])]
    assert voltage_ratio(flights) == pytest.approx(0.93)
    silent: Any = SimpleNamespace(vehicle=vehicle, battery=None, tracking=(10, 20))
    assert voltage_ratio([silent]) == 1.0


@pytest.mark.parametrize(
    ("without_m", "applied_m", "reason"),
    [
        (0.048, 0.015, ""),
        (
            0.048,
            0.104,
            "the traced model predicts 104.0 mm RMSE with the effects applied and 48.0 mm without",
        ),
        (np.inf, np.inf, "the traced model predicts inf mm RMSE with the effects applied and inf mm without"),
    ],
)
def test_effects_predicted_to_make_it_worse_are_not_applied(
    vehicle: Vehicle, without_m: float, applied_m: float, reason: str
) -> None:
    traced = model(vehicle, thrust_gain={"gain": 1.1})
    found, why = to_apply(traced, vehicle, EFFECTS, 1.0, lambda ff: without_m if ff is None else applied_m)
    assert (found is None) == bool(reason)
    assert why == reason


def test_effects_that_the_law_cannot_make_up_for_are_not_applied(vehicle: Vehicle) -> None:
    found, why = to_apply(model(vehicle, motor_lag={"extra_s": 0.02}), vehicle, EFFECTS, 1.0, lambda ff: 0.1)
    assert found is None
    assert why == "motor-lag: not compensable on board"
