"""The model predictive controllers of paper section V-B: nominal, L1-adaptive, and with a residual model."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from trimtab.firmware_model.law.ops import FLOAT
from trimtab.firmware_model.law.rotations import matrix_to_euler, quat_normalize, quat_to_matrix
from trimtab.host.base.errors import UsageError
from trimtab.host.control.adaptation import Adaptation
from trimtab.host.control.dynamics import COLLECTIVE, STATES, ControlModel
from trimtab.host.control.interface import ControlStep, RateCommand, SolveStatus, StateEstimate
from trimtab.host.control.settings import MpcSettings
from trimtab.host.control.solver import HorizonPlan, TrackingSolver
from trimtab.host.effects import Effect
from trimtab.host.log.tracking import ReferencePath
from trimtab.host.models.airframe import RATE, THETA, V
from trimtab.host.models.model import Model
from trimtab.host.models.reference import flat_outputs
from trimtab.host.vehicle import Vehicle
from trimtab.protocol.blobs import Reference

Array = NDArray[np.float64]

_YAW = THETA.stop - 1
_PITCH_MAX = math.radians(88.0)
"""Beyond this pitch, rad, Euler angles are too close to their singularity for a prediction."""
_NORM_ERROR_MAX = 0.1
"""Greatest difference of a quaternion's norm from 1."""


class Mpc:
    """A `Controller`. It tracks a reference with the commands that minimise a cost over the horizon."""

    def __init__(
        self,
        settings: MpcSettings,
        vehicle: Vehicle,
        *,
        model: Model | None = None,
        effects: Mapping[str, Effect] | None = None,
    ) -> None:
        """Build the solver. `model` is needed exactly if the settings ask for one; `effects`: its library.

        Raises UsageError for a model that is missing, not wanted or of another vehicle, and for a vehicle
        whose rate loop has no proportional gain; ValueError for unknown effects.
        """
        if (model is not None) != (settings.residual == "model"):
            remedy = "give a model file" if model is None else "leave the model out"
            raise UsageError(f'the controller has residual = "{settings.residual}"; {remedy}')
        if model is not None and model.vehicle_id != vehicle.id:
            raise UsageError(
                f"the model is of vehicle {model.vehicle_id}, not of {vehicle.name}; give another"
            )
        self.settings = settings
        self._model = ControlModel.of(vehicle, settings.rate_lag_s, model, effects)
        cost = cost_parameters(settings, self._model)
        self._solver = TrackingSolver(
            self._model,
            stages=settings.stages,
            step_s=settings.step_s,
            cost=cost,
            tolerance=settings.tolerance,
        )
        self._path: ReferencePath | None = None
        self._reset()

    @property
    def period_us(self) -> int:
        """Time between two control steps: the length of a stage."""
        return self.settings.step_us

    def begin(self, reference: Reference) -> None:
        """Prepare to follow `reference`; forget all earlier steps."""
        self._path = ReferencePath(reference)
        self._reset()

    def step(self, estimate: StateEstimate, sent: Sequence[RateCommand], act_us: int) -> ControlStep:
        """Return the command that takes effect at `act_us`; as of `Controller`.

        Raises RuntimeError before `begin`.
        """
        if self._path is None:
            raise RuntimeError("step before begin: the controller has no reference")
        with np.errstate(all="ignore"):
            measured = _measured(estimate)
            if measured is None:
                return self._refuse(act_us)
            x = self._observe(measured, estimate.t_us, sent)
            targets = self._targets(act_us)
            x0 = self._through(x, estimate.t_us, act_us, sent, targets[0, STATES:])
            if x0 is None or not np.isfinite(x0).all():
                return self._refuse(act_us)
            return self._solve(x0, targets, act_us)

    def _reset(self) -> None:
        self._solved: tuple[HorizonPlan, int] | None = None
        self._guess: tuple[HorizonPlan, int] | None = None
        self._last: tuple[Array, int] | None = None
        self._adaptation: Adaptation | None = None
        self._solver.disturb(np.zeros(3))

    def _targets(self, act_us: int) -> Array:
        """Return targets (N + 1, 17) at the nodes of a plan that starts at `act_us`."""
        assert self._path is not None
        times_s = 1e-6 * act_us + self.settings.step_s * np.arange(self.settings.stages + 1)
        return self._solver.targets(flat_outputs(self._path, times_s))

    def _observe(self, measured: Array, t_us: int, sent: Sequence[RateCommand]) -> Array:
        """Return the state (13) at an estimate (12): its thrust is predicted. Updates the adaptation."""
        thrust_n = _active(sent, t_us, np.full(4, self._model.weight_n))[3]
        if self._last is not None:
            before, before_us = self._last
            hold = np.append(before[RATE], before[COLLECTIVE])
            predicted = self._through(before, before_us, t_us, sent, hold)
            if predicted is not None and np.isfinite(predicted).all():
                thrust_n = predicted[COLLECTIVE]
                self._adapt(predicted, before, measured, 1e-6 * (t_us - before_us))
        x = np.append(measured, thrust_n)
        self._last = (x, t_us)
        return x

    def _adapt(self, predicted: Array, before: Array, measured: Array, dt_s: float) -> None:
        """Update the disturbance estimate with the velocity of an estimate, and use it."""
        if self.settings.adaptation is None or not dt_s > 0.0:
            return
        if self._adaptation is None:
            rates = self.settings.adaptation
            self._adaptation = Adaptation.at(before[V], rates.predictor_1_s, rates.bandwidth_1_s)
        gained = predicted[V] - before[V] - dt_s * self._adaptation.w_ned
        self._adaptation = self._adaptation.after(dt_s, gained, before[V], measured[V])
        self._solver.disturb(self._adaptation.w_ned)

    def _through(
        self, x: Array, from_us: int, to_us: int, sent: Sequence[RateCommand], hold: Array
    ) -> Array | None:
        """Return the state (13) after the commands in effect between two times; `hold` before the first.

        None where the times are further apart than the horizon.
        """
        if to_us - from_us > self.settings.stages * self.settings.step_us:
            return None
        changes = [command.t_us for command in sent if from_us < command.t_us < to_us]
        for begin_us, end_us in pairwise([from_us, *changes, to_us]):
            if end_us > begin_us:
                u = _active(sent, begin_us, hold)
                x = self._solver.advance(x, u, 1e-6 * (end_us - begin_us))
        return x

    def _solve(self, x0: Array, targets: Array, act_us: int) -> ControlStep:
        """Return the step from the state at `act_us`, starting at the plan before."""
        settings = self.settings
        x0 = x0.copy()
        x0[_YAW] += 2.0 * math.pi * round((targets[0, _YAW] - x0[_YAW]) / (2.0 * math.pi))
        start = self._shifted(self._guess, act_us) or self._solver.start(targets)
        solution = self._solver.solve(x0, targets, start, iterations_max=settings.iterations_max)
        self._guess = None if solution.plan is None else (solution.plan, act_us)
        if solution.status is SolveStatus.SOLVED:
            self._solved = self._guess
        return ControlStep(
            command=self._command(act_us), status=solution.status, iterations=solution.iterations
        )

    def _refuse(self, act_us: int) -> ControlStep:
        """Return the step where there is no state to plan from."""
        self._last = self._guess = None
        return ControlStep(command=self._command(act_us), status=SolveStatus.INFEASIBLE, iterations=0)

    def _command(self, act_us: int) -> RateCommand | None:
        """Return the command of the last solved plan at `act_us`; None where it has ended."""
        plan = self._shifted(self._solved, act_us)
        if plan is None:
            return None
        x, y, z, collective_n = (float(value) for value in plan.u[0])
        return RateCommand(act_us, (x, y, z), collective_n)

    def _shifted(self, plan: tuple[HorizonPlan, int] | None, act_us: int) -> HorizonPlan | None:
        """Return a plan as it continues at `act_us`; None outside its stages."""
        if plan is None:
            return None
        stage = (act_us - plan[1]) // self.settings.step_us
        return plan[0].shifted(stage) if 0 <= stage < self.settings.stages else None


def _measured(estimate: StateEstimate) -> Array | None:
    """Return position, velocity, Euler angles and body rate (12) of an estimate, None if it has none."""
    values = np.array(
        [*estimate.p_ned, *estimate.v_ned, *estimate.q_ned_frd, *estimate.rate_frd], dtype=float
    )
    q = values[6:10]
    if not np.isfinite(values).all() or not abs(np.linalg.norm(q) - 1.0) <= _NORM_ERROR_MAX:
        return None
    roll, pitch, yaw = matrix_to_euler(FLOAT, quat_to_matrix(FLOAT, quat_normalize(FLOAT, q.tolist())))
    if not abs(pitch) <= _PITCH_MAX:
        return None
    return np.array([*values[:6], roll, pitch, yaw, *values[10:]])


def _active(sent: Sequence[RateCommand], t_us: int, hold: Array) -> Array:
    """Return the inputs (4) in effect at a time; `hold` before the first command."""
    acting = [command for command in sent if command.t_us <= t_us]
    if not acting:
        return hold
    return np.array([*acting[-1].rate_frd, acting[-1].collective_n], dtype=float)


def cost_parameters(settings: MpcSettings, model: ControlModel) -> Array:
    """Return the parameters of the cost, in the order of `COST`."""
    w = settings.weights
    low, high = model.input_bounds()
    thrust = w.thrust_command / model.weight_n**2
    state = [*w.position_1_m2, *w.velocity_s2_m2, *w.attitude_1_rad2, *w.rate_s2_rad2, 0.0]
    tilt_cos = math.cos(math.radians(model.vehicle.limits.tilt_max_deg))
    shared = [*w.rate_command_s2_rad2, thrust, w.tilt, tilt_cos]
    return np.array([*state, *(w.terminal * value for value in state), *shared, *low, *high])
