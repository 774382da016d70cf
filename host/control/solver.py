"""The tracking problem of a model, solved by multiple shooting from the plan before.

The problem has one stage more than the horizon: its states, at the horizon's end, carry the terminal weights,
and its inputs stay at their target. `trimtab.host.shooting` solves it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from trimtab.host.codegen import compile_function
from trimtab.host.codegen.buffered import Buffered
from trimtab.host.control.cost import COST, STAGE_SIZE, stage_parameters
from trimtab.host.control.dynamics import DISTURBANCE, INPUTS, STATES, ControlModel
from trimtab.host.control.interface import SolveStatus
from trimtab.host.control.prediction import advance_function, stage_model
from trimtab.host.control.targets import target_function
from trimtab.host.shooting import problem as shooting
from trimtab.host.shooting.problem import Multipliers, Problem
from trimtab.host.shooting.solver import Repeated

Array = NDArray[np.float64]

_FIRST_BARRIER = 10.0
_STATUS = {
    shooting.SolveStatus.SOLVED: SolveStatus.SOLVED,
    shooting.SolveStatus.INVALID_NUMBER: SolveStatus.INFEASIBLE,
}


@dataclass(frozen=True, kw_only=True, eq=False)
class HorizonPlan:
    """States, inputs and multipliers over the horizon and the last stage.

    The first costate is that of the given state.
    """

    x: Annotated[np.ndarray, "stages+2 13"]
    u: Annotated[np.ndarray, "stages+1 4"]
    multipliers: Multipliers

    def shifted(self, stages: int) -> HorizonPlan:
        """Return the plan that starts this many stages later; the last stage repeats."""
        count = len(self.u)
        nodes = np.minimum(np.arange(count + 1) + stages, count)
        intervals = np.minimum(nodes[:-1], count - 1)
        costates, limits = self.multipliers.costates[:, nodes], np.zeros_like(self.multipliers.limits)
        limits[:, :-1] = self.multipliers.limits[:, intervals]
        limits[:STATES, 0] = -costates[:, 0]
        return HorizonPlan(
            x=self.x[nodes],
            u=self.u[intervals],
            multipliers=replace(self.multipliers, costates=costates, limits=limits),
        )


@dataclass(frozen=True, kw_only=True, eq=False)
class Solution:
    """Outcome of a solve; the plan is the last one found whatever the status, None if it is not finite."""

    plan: HorizonPlan | None
    status: SolveStatus
    iterations: int


class TrackingSolver:
    """The tracking problem of a model over `stages` steps, as fixed memory.

    tolerance: distance of an input from the solution, as a share of its range, at which a solve ends.
    """

    def __init__(
        self, model: ControlModel, *, stages: int, step_s: float, cost: Array, tolerance: float
    ) -> None:
        self.stages, self.step_s = stages, step_s
        self._advance, self._targets = (
            Buffered(compile_function(function, native=True)[0])
            for function in (advance_function(model), target_function(model, stages))
        )
        for call in (self._advance, self._targets):
            call.inputs["xi"][0] = model.weights
            call.inputs["p"][0] = model.parameters
            call.inputs["step_s"][:] = step_s
        of_model = len(model.parameters)
        self._parameters = np.zeros((of_model + STAGE_SIZE + STATES + INPUTS, stages + 1))
        self._parameters[:of_model] = model.parameters[:, None]
        self._parameters[of_model : of_model + STAGE_SIZE] = stage_parameters(cost, stages)
        # The Hessian of the cost in an input is at least its weight, so this slope bounds the distance.
        range_ = cost[COST.high] - cost[COST.low]
        self._tolerance = tolerance * float((cost[COST.input] * range_).min())
        self._solver = Repeated(stage_model(model, step_s), self._problem(cost))

    def _problem(self, cost: Array) -> Problem:
        """Return the problem for states and targets that are zero."""
        count = self.stages + 1
        free = np.full((STATES, count + 1), np.inf)
        given = np.where(np.arange(count + 1) > 0, free, 0.0)
        low, high = (np.repeat(cost[at][:, None], count, axis=1) for at in (COST.low, COST.high))
        return Problem(
            leg_of=np.zeros(count, dtype=np.int64),
            h0_s=np.full(count, self.step_s),
            parameters=self._parameters,
            x_bounds=(-given, given),
            u_bounds=(low, high),
            path_bounds=(np.zeros((0, count)), np.zeros((0, count))),
            h_bounds=(1.0, 1.0),
            total_bounds_s=(-np.inf, np.inf),
            x_start=np.zeros_like(free),
            u_start=0.5 * (low + high),
            h_start=np.ones(1),
            near=True,
        )

    def disturb(self, w_ned: Annotated[np.ndarray, "3"]) -> None:
        """Set the constant disturbance (m/s^2, NED) of the model."""
        self._parameters[DISTURBANCE] = w_ned[:, None]
        for call in (self._advance, self._targets):
            call.inputs["p"][0, DISTURBANCE] = w_ned

    def advance(
        self, x: Annotated[np.ndarray, "13"], u: Annotated[np.ndarray, "4"], dt_s: float
    ) -> Annotated[np.ndarray, "13"]:
        """Return the predicted state after `dt_s` under constant inputs, by RK4 steps of at most `step_s`."""
        count = max(1, int(np.ceil(dt_s / self.step_s - 1e-9)))
        call = self._advance
        call.inputs["u"][0], call.inputs["step_s"][:] = u, dt_s / count
        call.outputs["next"][0] = x
        for _ in range(count):
            call.inputs["x"][:] = call.outputs["next"]
            call()
        return call.outputs["next"].reshape(-1).copy()

    def targets(self, flat: Annotated[np.ndarray, "14 nodes"]) -> Annotated[np.ndarray, "nodes 17"]:
        """Return the targets at flat outputs of the nodes."""
        self._targets.inputs["flat"][:] = flat.T
        self._targets()
        return self._targets.outputs["targets"].copy()

    def start(self, targets: Annotated[np.ndarray, "nodes 17"]) -> HorizonPlan:
        """Return the plan that the first solve starts from: the targets."""
        nodes = np.append(np.arange(self.stages + 1), self.stages)
        unknown = Multipliers(
            costates=np.zeros((STATES, len(nodes))),
            limits=np.zeros((STATES + INPUTS, len(nodes))),
            barrier=_FIRST_BARRIER,
        )
        return HorizonPlan(x=targets[nodes, :STATES], u=targets[:, STATES:], multipliers=unknown)

    def solve(
        self,
        x0: Annotated[np.ndarray, "13"],
        targets: Annotated[np.ndarray, "nodes 17"],
        start: HorizonPlan,
        *,
        iterations_max: int,
    ) -> Solution:
        """Return the plan from `x0` that follows the targets best."""
        self._parameters[-STATES - INPUTS :] = targets.T
        found = self._solver.solve(
            x0,
            self._parameters,
            start.x.T,
            start.u.T,
            start.multipliers,
            tolerance=self._tolerance,
            max_iterations=iterations_max,
        )
        status = _STATUS.get(found.status, SolveStatus.BUDGET_SPENT)
        if status is SolveStatus.INFEASIBLE:
            return Solution(plan=None, status=status, iterations=found.iterations)
        known = found.multipliers or start.multipliers  # Ipopt has none
        costates = known.costates.copy()
        costates[:, 0] = -known.limits[:STATES, 0]
        plan = HorizonPlan(x=found.x.T, u=found.u.T, multipliers=replace(known, costates=costates))
        return Solution(plan=plan, status=status, iterations=found.iterations)
