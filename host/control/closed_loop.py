"""A controller in a loop with the host's own model, which may have drag and wind that the controller lacks.

It tunes, measures and tests controllers without radio, firmware and plant.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np

from trimtab.firmware_model.law.ops import FLOAT
from trimtab.firmware_model.law.rotations import quat_from_euler
from trimtab.host.codegen import compile_function
from trimtab.host.codegen.buffered import Buffered
from trimtab.host.control.dynamics import COLLECTIVE, DISTURBANCE, STATES, ControlModel
from trimtab.host.control.interface import Controller, ControlStep, RateCommand, StateEstimate, Triple
from trimtab.host.control.prediction import advance_function
from trimtab.host.models.airframe import RATE, THETA, P, V
from trimtab.host.models.reference import flat_outputs
from trimtab.protocol.blobs import Reference

PLANT_STEP_US = 5_000
DELAY_US = 20_000
"""Time from an estimate to the effect of its command: computing time and uplink."""
_SENT = 8
"""Number of commands that a controller is told of, oldest first."""


@dataclass(frozen=True, kw_only=True, eq=False)
class ControlledFlight:
    """Times (s), states, distances from the reference (m) and results of the control steps of a flight."""

    t_s: Annotated[np.ndarray, "steps"]
    x: Annotated[np.ndarray, "steps 13"]
    error_m: Annotated[np.ndarray, "steps"]
    steps: tuple[ControlStep, ...]


class Plant:
    """The model of a vehicle, with a constant disturbance (m/s^2, NED), integrated by short steps."""

    def __init__(self, model: ControlModel, disturbance_ned: Triple = (0.0, 0.0, 0.0)) -> None:
        self.weight_n = model.weight_n
        self._call = Buffered(compile_function(advance_function(model))[0])
        inputs = self._call.inputs
        inputs["p"][0], inputs["xi"][0] = model.parameters, model.weights
        inputs["p"][0, DISTURBANCE] = disturbance_ned
        inputs["step_s"][:] = 1e-6 * PLANT_STEP_US

    def after(self, x: Annotated[np.ndarray, "13"], command: RateCommand) -> Annotated[np.ndarray, "13"]:
        """Return the state after `PLANT_STEP_US` under a command."""
        self._call.inputs["x"][0] = x
        self._call.inputs["u"][0] = (*command.rate_frd, command.collective_n)
        self._call()
        return self._call.outputs["next"][0].copy()


def estimate_of(x: Annotated[np.ndarray, "13"], t_us: int) -> StateEstimate:
    """Return the estimate of a state without error."""
    roll, pitch, yaw = x[THETA].tolist()
    w, i, j, k = quat_from_euler(FLOAT, roll, pitch, yaw)
    p, v, rate = ((float(a[0]), float(a[1]), float(a[2])) for a in (x[P], x[V], x[RATE]))
    return StateEstimate(t_us, p, v, (w, i, j, k), rate)


def hover_at(reference: Reference, weight_n: float) -> Annotated[np.ndarray, "13"]:
    """Return the state at rest at the start of a reference."""
    x, flat = np.zeros(STATES), flat_outputs(reference, np.zeros(1))[:, 0]
    x[P], x[THETA.stop - 1], x[COLLECTIVE] = flat[:3], flat[12], weight_n
    return x


def fly(
    controller: Controller,
    plant: Plant,
    reference: Reference,
    *,
    hold_us: int = 1_000_000,
    x0: Annotated[np.ndarray, "13"] | None = None,
) -> ControlledFlight:
    """Fly a reference, and hold its end for `hold_us`; from hover at its start, or from `x0`."""
    x = hover_at(reference, plant.weight_n) if x0 is None else x0
    controller.begin(reference)
    sent = [RateCommand(-DELAY_US, (0.0, 0.0, 0.0), plant.weight_n)]
    times, states, steps = [], [], []
    for t_us in range(0, reference.duration_us + hold_us, PLANT_STEP_US):
        if t_us % controller.period_us == 0:
            step = controller.step(estimate_of(x, t_us), sent, t_us + DELAY_US)
            if step.command is not None:
                sent = [*sent[1 - _SENT :], step.command]
            times.append(1e-6 * t_us)
            states.append(x)
            steps.append(step)
        x = plant.after(x, [command for command in sent if command.t_us <= t_us][-1])
    t_s, path = np.array(times), np.array(states)
    p_ref = flat_outputs(reference, t_s)[:3].T
    error_m = np.linalg.norm(path[:, P] - p_ref, axis=1)
    return ControlledFlight(t_s=t_s, x=path, error_m=error_m, steps=tuple(steps))
