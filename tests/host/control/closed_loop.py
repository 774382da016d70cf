"""A controller in a loop with the host's own model, which may have drag and wind that it does not know."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np

from trimtab.firmware_model.law.ops import FLOAT
from trimtab.firmware_model.law.rotations import quat_from_euler
from trimtab.host.codegen import compile_function
from trimtab.host.codegen.buffered import Buffered
from trimtab.host.control.dynamics import STATES, ControlModel
from trimtab.host.control.interface import Controller, ControlStep, RateCommand, StateEstimate
from trimtab.host.control.sweeps import sweeps
from trimtab.host.models.airframe import RATE, THETA, P, V
from trimtab.host.models.reference import flat_outputs
from trimtab.protocol.blobs import Reference

PLANT_STEP_US = 5_000
DELAY_US = 20_000
"""From an estimate to the effect of its command: computing time and uplink."""


@dataclass(frozen=True, kw_only=True)
class Flown:
    """Times (s) and states of a flight at the control steps, and the steps."""

    t_s: Annotated[np.ndarray, "steps"]
    x: Annotated[np.ndarray, "steps 13"]
    steps: list[ControlStep]
    error_m: Annotated[np.ndarray, "steps"]

    @property
    def commands(self) -> Annotated[np.ndarray, "steps 4"]:
        """Commands, NaN where there was none."""
        none = RateCommand(0, (np.nan, np.nan, np.nan), np.nan)
        rows = [step.command or none for step in self.steps]
        return np.array([[*row.rate_frd, row.collective_n] for row in rows])


class Plant:
    """The host's model, with a wind as a constant acceleration, integrated by short steps."""

    def __init__(self, model: ControlModel, wind_m_s2: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> None:
        self._call = Buffered(compile_function(sweeps(model, 1).advance)[0])
        self._call.inputs["p"][0] = model.parameters
        self._call.inputs["p"][0, :3] = wind_m_s2
        self._call.inputs["xi"][0] = model.weights
        self._call.inputs["step_s"][:] = 1e-6 * PLANT_STEP_US

    def after(self, x: np.ndarray, u: np.ndarray) -> np.ndarray:
        self._call.inputs["x"][0], self._call.inputs["u"][0] = x, u
        self._call()
        return self._call.outputs["next"].reshape(-1).copy()


def estimate(x: np.ndarray, t_us: int) -> StateEstimate:
    q = quat_from_euler(FLOAT, *x[THETA].tolist())
    return StateEstimate(t_us, tuple(x[P]), tuple(x[V]), tuple(q), tuple(x[RATE]))  # type: ignore[arg-type]


def hover(reference: Reference, weight_n: float) -> np.ndarray:
    x = np.zeros(STATES)
    flat = flat_outputs(reference, np.zeros(1))[:, 0]
    x[P], x[THETA.stop - 1], x[STATES - 1] = flat[:3], flat[12], weight_n
    return x


def fly(
    controller: Controller,
    plant: Plant,
    reference: Reference,
    weight_n: float,
    *,
    extra_us: int = 1_000_000,
    x0: np.ndarray | None = None,
) -> Flown:
    """Fly a reference from hover at its start, and hold its end for `extra_us`."""
    x = hover(reference, weight_n) if x0 is None else x0.copy()
    controller.begin(reference)
    sent: list[RateCommand] = [RateCommand(-1_000_000, (0.0, 0.0, 0.0), weight_n)]
    times, states, steps = [], [], []
    for t_us in range(0, reference.duration_us + extra_us, PLANT_STEP_US):
        if t_us % controller.period_us == 0:
            step = controller.step(estimate(x, t_us), sent[-8:], t_us + DELAY_US)
            if step.command is not None:
                sent.append(step.command)
            times.append(1e-6 * t_us)
            states.append(x)
            steps.append(step)
        active = [command for command in sent[-8:] if command.t_us <= t_us][-1]
        x = plant.after(x, np.array([*active.rate_frd, active.collective_n]))
    p_ref = flat_outputs(reference, np.array(times))[:3].T
    x_all = np.array(states)
    return Flown(
        t_s=np.array(times), x=x_all, steps=steps, error_m=np.linalg.norm(x_all[:, P] - p_ref, axis=1)
    )
