"""Errors of a model on flights whose accelerations are known: pointwise and along roll-outs."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from trimtab.host.apps.paper.learning.flights import STEP_S, Flights, accelerations
from trimtab.host.models.drive import flight_constants
from trimtab.host.models.network import Network
from trimtab.host.models.phi import Phi
from trimtab.host.models.rollout import roll_out


@dataclass(frozen=True, kw_only=True)
class AccelerationError:
    """Root mean squares, m/s^2, of the norm of the error; per component, divide by sqrt 3.

    `pointwise` is at the flight's states. `rolled` is along the predicted paths of whole flights, predicted
    from their references, compared at equal times.
    """

    pointwise: float
    rolled: float

    def to_json(self) -> dict[str, float | None]:
        """Return both as norm and per component; None if a roll-out diverged."""
        values = {
            "pointwise_norm": self.pointwise,
            "pointwise_component": self.pointwise / 3**0.5,
            "rolled_norm": self.rolled,
            "rolled_component": self.rolled / 3**0.5,
        }
        return {name: value if np.isfinite(value) else None for name, value in values.items()}


@dataclass(frozen=True, kw_only=True, eq=False)
class Candidate:
    """A model that is judged: phi at theta (P,), with a network or none."""

    phi: Phi
    theta: np.ndarray
    network: Network | None = None

    def roll_out(self, flights: Flights, step_s: float = STEP_S) -> np.ndarray:
        """Return states (F, n, size) at the flights' nodes, predicted from their references.

        Steps of `step_s` are subdivided if RK4 needs it. A multiple of STEP_S gives fewer nodes.
        """
        split = self.phi.substeps(step_s)
        every = max(1, round(STEP_S / step_s)) * split
        states = roll_out(
            self.phi,
            x0=flights.x[:, 0].T,
            drive=flights.drives(step_s / split).transpose(1, 2, 0),
            flight=flight_constants(),
            theta=self.theta,
            step_s=step_s / split,
            every=every,
            network=self.network,
            rows=self.phi.size,
            compiled=True,
        )
        return states.transpose(2, 0, 1)


def acceleration_error(candidate: Candidate, flights: Flights) -> AccelerationError:
    """Return the acceleration error of a model on exact flights."""
    drive = flights.drives(STEP_S)[:, ::2]
    true = accelerations(flights.phi, flights.theta, None, flights.x, drive)
    model = (candidate.phi, candidate.theta, candidate.network)
    pointwise = accelerations(*model, flights.x, drive) - true
    rolled = accelerations(*model, candidate.roll_out(flights), drive) - true
    return AccelerationError(pointwise=rms_norm(pointwise), rolled=rms_norm(rolled))


def position_error_m(candidate: Candidate, flights: Flights, step_s: float = STEP_S) -> float:
    """Return the position RMSE of whole flights predicted from their references."""
    states = candidate.roll_out(flights, step_s)
    stride = max(1, round(step_s / STEP_S))
    return rms_norm(states[..., :3] - flights.x[:, ::stride, :3][:, : states.shape[1]])


def rms_norm(error: np.ndarray) -> float:
    """Return the RMS of the norm over all but the last axis; infinite if it is not a number."""
    value = float(np.sqrt((error**2).sum(-1).mean()))
    return value if np.isfinite(value) else float("inf")
