"""What of a traced model goes on board."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from trimtab.host.apps.demo.applied import to_apply
from trimtab.host.effects import load_effects
from trimtab.host.models.model import Model
from trimtab.host.vehicle import Vehicle

EFFECTS = load_effects()


def model(vehicle: Vehicle, **effects: Any) -> Model:
    named = {name.replace("_", "-"): values for name, values in effects.items()}
    return Model(vehicle_id=vehicle.id, vehicle_name=vehicle.name, effects=named)


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
    found, why = to_apply(traced, vehicle, EFFECTS, lambda ff: without_m if ff is None else applied_m)
    assert (found is None) == bool(reason)
    assert why == reason


def test_effects_that_the_law_cannot_make_up_for_are_not_applied(vehicle: Vehicle) -> None:
    found, why = to_apply(model(vehicle, motor_lag={"extra_s": 0.02}), vehicle, EFFECTS, lambda ff: 0.1)
    assert found is None
    assert why == "motor-lag: not compensable on board"
