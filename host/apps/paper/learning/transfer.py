"""What is learned at one step and under one law, predicting at other steps and under other laws.

The paper's first remark: a residual of the state alone, learned under one controller, holds under others, as
long as the network is not overly complicated.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from trimtab.host.apps.paper.learning.flights import Flights, fly
from trimtab.host.apps.paper.learning.measure import Candidate, acceleration_error, position_error_m
from trimtab.host.apps.paper.learning.methods import DEEP, learn_exact
from trimtab.host.models.phi import Phi
from trimtab.host.vehicle import Vehicle, to_parameters

STEPS_S = (0.005, 0.01, 0.02, 0.04)
FEW = 4
"""Flights that the over-large network learns from."""

_SOFTER = {"position_p": 0.6, "velocity_d": 0.7, "attitude_p": 0.8}
"""Gain set B, in shares of the vehicle file's."""
_OBSERVER = 5.0
"""1/s, bandwidth of the disturbance observer."""


def steps(candidate: Candidate, flights: Flights) -> list[dict[str, Any]]:
    """Position error of whole flights, by the roll-out's step."""
    return [
        {"step_s": step_s, "position_rmse_m": position_error_m(candidate, flights, step_s)}
        for step_s in STEPS_S
    ]


def laws(candidate: Candidate, sets: dict[str, Flights], seed: int, iterations: int) -> list[dict[str, Any]]:
    """Errors of what was learned under the vehicle file's gains (A), by law and network.

    `candidate`, a network of 2 x 32 learned from all training flights, and the largest the vehicle can hold
    learned from a few, without regularisation or early stop.
    """
    few, vehicle = sets["train"].take(FEW), sets["train"].phi.vehicle
    large = learn_exact(few, few, DEEP, seed, iterations=iterations, l2=0.0)
    learned = {
        "2 x 32, all flights": candidate,
        f"3 x 32, {FEW} flights, not regularised": large.candidate,
    }
    rows = []
    for law, parameters in _laws(vehicle).items():
        flights = {name: _flown(sets[name], vehicle, parameters) for name in ("test", "ood")}
        phi = Phi(vehicle=vehicle, estimator=False, parameters=parameters)
        nominal = Candidate(phi=phi, theta=phi.theta_neutral)
        for name, found in learned.items():
            hybrid = replace(found, phi=phi, theta=phi.theta_neutral)
            row: dict[str, Any] = {"law": law, "network": name}
            for which, flown in flights.items():
                error = position_error_m(hybrid, flown)
                row[which] = {
                    "acceleration_rmse": acceleration_error(hybrid, flown).pointwise,
                    "position_rmse_m": error if np.isfinite(error) else None,
                    "nominal_position_rmse_m": position_error_m(nominal, flown),
                }
            rows.append(row)
    return rows


def _laws(vehicle: Vehicle) -> dict[str, dict[str, float]]:
    """Return the firmware's parameters by law."""
    gains = vehicle.gains
    softer = gains.model_copy(
        update={key: tuple(share * k for k in getattr(gains, key)) for key, share in _SOFTER.items()}
    )
    observed = gains.model_copy(update={"observer": _OBSERVER})
    sets = {"gain set A": gains, "gain set B": softer, "gain set A, observer on": observed}
    return {name: to_parameters(vehicle.model_copy(update={"gains": each})) for name, each in sets.items()}


def _flown(known: Flights, vehicle: Vehicle, parameters: dict[str, float]) -> Flights:
    """Return the same references with the same drag under another law."""
    phi = Phi(vehicle=vehicle, effects=known.phi.effects, estimator=False, parameters=parameters)
    return fly(phi, known.theta, known.references)
