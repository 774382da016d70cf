"""Prediction errors of whole flights, by which a model is judged."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np

from trimtab.firmware_model.law.ops import FLOAT
from trimtab.host.effects import Effect
from trimtab.host.log import Flight
from trimtab.host.models.airframe import Part
from trimtab.host.models.model import Model
from trimtab.host.models.network import Network
from trimtab.host.models.phi import Phi
from trimtab.host.models.rollout import half_steps, reference_drive, roll_out
from trimtab.host.models.slots import mocap_latency_s
from trimtab.host.models.states import States, flight_states


@dataclass(frozen=True, kw_only=True)
class Errors:
    """Root mean square over all samples of the norm of the error: m and m/s."""

    position_rmse_m: float
    velocity_rmse_m_s: float

    def to_json(self) -> dict[str, float | None]:
        """Return the two numbers; None where a roll-out diverged."""
        return {name: value if np.isfinite(value) else None for name, value in vars(self).items()}


def errors_of(squares: Annotated[np.ndarray, "samples columns"]) -> Errors:
    """Return the errors whose squares, by component, are these: position, velocity and others."""
    return Errors(
        position_rmse_m=float(np.sqrt(squares[:, 0:3].sum(axis=1).mean())),
        velocity_rmse_m_s=float(np.sqrt(squares[:, 3:6].sum(axis=1).mean())),
    )


def whole_flights(
    phi: Phi,
    theta: Annotated[np.ndarray, "parameters"],
    flights: Sequence[States],
    network: Network | None = None,
) -> Errors:
    """Return the errors of whole flights predicted from their references, from the first tracked state.

    All samples with poses near them count equally.
    """
    squares: list[np.ndarray] = []
    for states in flights:
        predicted = predict(phi, theta, states, network)
        square = (predicted - states.x)[:, :6] ** 2
        squares.append(square if states.seen is None else square[states.seen])
    return errors_of(np.concatenate(squares))


def predict(
    phi: Phi, theta: Annotated[np.ndarray, "parameters"], states: States, network: Network | None = None
) -> Annotated[np.ndarray, "samples 12"]:
    """Return the 12 states of a flight at its samples, predicted from its reference."""
    split = phi.substeps(states.step_s)
    step_s = states.step_s / split
    times = half_steps(states.t_s[0], split * (len(states.t_s) - 1), step_s)
    voltage = np.interp(times, states.t_s, states.voltage_ratio)
    drive = reference_drive(states.reference, times, feedforward=states.feedforward, voltage_ratio=voltage)
    return roll_out(
        phi,
        x0=states.initial(phi)[:, None],
        drive=drive,
        flight=states.constants,
        theta=theta,
        step_s=step_s,
        every=split,
        network=network,
        compiled=True,
    )[:, :, 0]


def model_errors(flights: Sequence[Flight], model: Model | None, effects: Mapping[str, Effect]) -> Errors:
    """Return a model's errors on whole flights of one vehicle and one setting; None: the vehicle file alone.

    Raises TooLittleData.
    """
    parts = model_parts(model, effects)
    states = flight_states(flights, latency_s=float(mocap_latency_s(FLOAT, parts)))
    phi = Phi(
        vehicle=flights[0].vehicle,
        effects=tuple(effect for effect, _ in parts),
        parameters=states[0].parameters,
    )
    return whole_flights(phi, phi.theta(parts), states, None if model is None else model.network)


def model_parts(model: Model | None, effects: Mapping[str, Effect]) -> list[Part]:
    """Return the model's effects, and those of its adjustments that are effects; none without a model."""
    if model is None:
        return []
    known = {name: values for name, values in model.adjustments.items() if name in effects}
    return replace(model, adjustments=known, covariance=None).parts(effects)
