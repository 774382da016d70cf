"""Real-time iterations of the tracking problem: from a shifted plan to one that solves it.

Each iteration predicts the plan's states with their derivatives and returns its best change within the bounds
of the inputs (`trimtab.host.control.sweeps`). A change that does not lower the cost is halved. Compiled code
and CasADi's virtual machine give the same bits.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from trimtab.host.codegen import compile_function
from trimtab.host.codegen.buffered import Buffered
from trimtab.host.control.dynamics import STATES, ControlModel
from trimtab.host.control.feedback import GAINS
from trimtab.host.control.interface import SolveStatus
from trimtab.host.control.sweeps import sweeps
from trimtab.host.control.targets import target_function

Array = NDArray[np.float64]

_HALVINGS = 5
_LEAST_SHARE = 1e-4
"""Share of the predicted decrease that a change must bring."""
_ROUNDING = 1e-10
"""Relative decrease of the cost below which rounding decides whether a change lowers it."""


@dataclass(frozen=True, kw_only=True, eq=False)
class HorizonPlan:
    """States and inputs over the horizon, and the feedback K (52, 4 x 13 by columns) about them."""

    x: Annotated[np.ndarray, "nodes 13"]
    u: Annotated[np.ndarray, "stages 4"]
    K: Annotated[np.ndarray, "stages 52"]

    def shifted(self, stages: int) -> HorizonPlan:
        """Return the plan that starts this many stages later; the last stage repeats."""
        count = len(self.u)
        keep = np.minimum(np.arange(count) + stages, count - 1)
        return HorizonPlan(
            x=self.x[np.minimum(np.arange(count + 1) + stages, count)], u=self.u[keep], K=self.K[keep]
        )


@dataclass(frozen=True, kw_only=True, eq=False)
class Solution:
    """Outcome of a solve; the plan is the best one found whatever the status, None if it is not finite."""

    plan: HorizonPlan | None
    status: SolveStatus
    iterations: int


class TrackingSolver:
    """The tracking problem of a model over `stages` steps, as fixed memory."""

    def __init__(self, model: ControlModel, *, stages: int, step_s: float, cost: Array) -> None:
        functions = sweeps(model, stages)
        self.stages, self.step_s = stages, step_s
        self._advance, self._forward, self._backward, self._targets = (
            Buffered(compile_function(function)[0])
            for function in (
                functions.advance,
                functions.forward,
                functions.backward,
                target_function(model, stages),
            )
        )
        for call in (self._advance, self._forward, self._targets):
            call.inputs["xi"][0] = model.weights
            call.inputs["p"][0] = model.parameters
            call.inputs["step_s"][:] = step_s
        for call in (self._forward, self._backward):
            call.inputs["cost"][0] = cost

    def disturb(self, w_ned: Annotated[np.ndarray, "3"]) -> None:
        """Set the constant disturbance (m/s^2, NED) of the model."""
        for call in (self._advance, self._forward, self._targets):
            call.inputs["p"][0, :3] = w_ned

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
        """Return the plan that the first solve starts from: the targets, without feedback."""
        return HorizonPlan(x=targets[:, :STATES], u=targets[:-1, STATES:], K=np.zeros((self.stages, GAINS)))

    def solve(
        self,
        x0: Annotated[np.ndarray, "13"],
        targets: Annotated[np.ndarray, "nodes 17"],
        start: HorizonPlan,
        *,
        iterations_max: int,
        tolerance: float,
    ) -> Solution:
        """Return the plan from `x0` that follows the targets best.

        It is solved where no input changes by more than `tolerance` of its range in an iteration.
        """
        forward, backward = self._forward, self._backward
        forward.inputs["x0"][0] = x0
        forward.inputs["reference"][:] = targets
        backward.inputs["reference"][:] = targets
        forward.inputs["k"][:] = 0.0
        self._predict(start.x[:-1], start.u, start.K, 0.0)
        if not self._finite():
            return Solution(plan=None, status=SolveStatus.INFEASIBLE, iterations=0)
        for iteration in range(1, iterations_max + 1):
            for name in ("x", "u", "A", "B"):
                backward.inputs[name][:] = forward.outputs[name]
            backward()
            change = float(backward.outputs["change"][0, 0])
            if not np.isfinite(change):
                return Solution(plan=None, status=SolveStatus.INFEASIBLE, iterations=iteration)
            plan = HorizonPlan(
                x=backward.inputs["x"].copy(),
                u=backward.inputs["u"].copy(),
                K=backward.outputs["K"].copy(),
            )
            if change <= tolerance:
                return Solution(plan=plan, status=SolveStatus.SOLVED, iterations=iteration)
            if not self._improve(plan):
                return Solution(plan=plan, status=SolveStatus.BUDGET_SPENT, iterations=iteration)
        return Solution(plan=self._present(), status=SolveStatus.BUDGET_SPENT, iterations=iterations_max)

    def _improve(self, plan: HorizonPlan) -> bool:
        """Predict the changed plan with the greatest share of the change that lowers the cost enough."""
        before = float(self._forward.outputs["total"][0, 0])
        decrease = float(self._backward.outputs["decrease"][0, 0])
        self._forward.inputs["k"][:] = self._backward.outputs["k"]
        share = 1.0
        for _ in range(_HALVINGS + 1):
            self._predict(plan.x[:-1], plan.u, plan.K, share)
            total = float(self._forward.outputs["total"][0, 0])
            enough = before - _LEAST_SHARE * share * decrease + _ROUNDING * before
            if self._finite() and total <= enough:
                return True
            share *= 0.5
        return False

    def _predict(self, x: Array, u: Array, K: Array, share: float) -> None:
        forward = self._forward
        forward.inputs["x_plan"][:], forward.inputs["u_plan"][:], forward.inputs["K"][:] = x, u, K
        forward.inputs["alpha"][:] = share
        forward()

    def _finite(self) -> bool:
        outputs = self._forward.outputs
        return bool(np.isfinite(outputs["total"][0, 0]) and np.isfinite(outputs["x"]).all())

    def _present(self) -> HorizonPlan:
        outputs = self._forward.outputs
        return HorizonPlan(x=outputs["x"].copy(), u=outputs["u"].copy(), K=self._backward.outputs["K"].copy())
