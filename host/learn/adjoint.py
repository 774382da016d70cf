"""Paper Algorithm 1 in CasADi: roll-out (eq. 7), adjoint (eq. 8), gradient (eq. 9) of a batch of segments.

One RK4 step of the hybrid closed loop Phi(x, x_bar, xi) = phi(x, x_bar) + d(x, xi) is an MX function of all
segments of the batch, and its adjoint is CasADi's reverse mode. It needs no compiler, and is independent of
the adjoint in `kernel.c`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated

import casadi
import numpy as np

from trimtab.host.codegen import held_interrupts
from trimtab.host.codegen.buffered import Buffered
from trimtab.host.learn.kernel import MEASURED
from trimtab.host.models.network import Layout
from trimtab.host.models.phi import Phi
from trimtab.host.models.rollout import roll_out
from trimtab.host.models.segments import Segments
from trimtab.host.models.step import step_function

Pushed = Callable[
    [
        Annotated[np.ndarray, "segments size"],
        Annotated[np.ndarray, "segments parameters"],
        Annotated[np.ndarray, "segments stages 3"],
    ],
    Annotated[np.ndarray, "segments nodes size"],
]
"""(x0, theta, push) -> states: a roll-out of segments.

push: an acceleration, NED, at the start, middle and end of each part of a step.
"""


@dataclass(frozen=True, kw_only=True)
class Gradient:
    """Loss and its gradients by xi, theta and each segment's start."""

    loss: float
    xi: Annotated[np.ndarray, "weights"]
    x0: Annotated[np.ndarray, "segments size"]
    theta: Annotated[np.ndarray, "parameters"]


def check_split(segments: Segments, split: int) -> None:
    """Raise ValueError if the segments were not cut for a model whose steps have `split` parts."""
    if segments.split != split:
        raise ValueError(f"segments in {segments.split} parts a step, but this model needs {split}")


class Rollouts:
    """Roll-outs of a batch of segments and their gradient. `weight`: diagonal L of the loss.

    The loss of a segment is the mean over its steps of (x_r - x)' L (x_r - x) (paper eq. 3). The loss of the
    batch is the sum over its segments. A step has as many parts as an RK4 step of phi needs to be stable.
    """

    def __init__(
        self,
        phi: Phi,
        layout: Layout,
        theta: Annotated[np.ndarray, "parameters"],
        *,
        batch: int,
        step_s: float,
        weight: Annotated[np.ndarray, "12"],
    ) -> None:
        self.phi, self.layout, self.batch, self.split = phi, layout, batch, phi.substeps(step_s)
        self.step_s = step_s / self.split
        self.weight = np.asarray(weight, dtype=float)
        step = step_function(phi, layout, batch)
        self._step, self._adjoint = Buffered(step), Buffered(_adjoint(step))
        for function in (self._step, self._adjoint):
            function.inputs["theta"][:] = np.asarray(theta)[:, None]
            function.inputs["step_s"][:] = self.step_s

    def roll_out(
        self,
        segments: Segments,
        x0: Annotated[np.ndarray, "segments size"],
        xi: Annotated[np.ndarray, "weights"],
    ) -> Annotated[np.ndarray, "nodes segments size"]:
        """Return the states from the starts x0: equation 7."""
        return self._rolled(segments, x0, xi)[:: self.split, : segments.count]

    def _rolled(self, segments: Segments, x0: np.ndarray, xi: np.ndarray) -> np.ndarray:
        """Return the states after all parts of steps of the batch, filled up with the first segment."""
        check_split(segments, self.split)
        step = self._step
        states = np.empty((self.split * segments.steps + 1, self.batch, self.phi.size))
        states[0] = self._filled(x0)
        self._load(step, segments, xi)
        for k in range(len(states) - 1):
            self._load_drive(step, segments, k)
            step.inputs["x"][:] = states[k].T
            step()
            states[k + 1] = step.outputs["next"].T
        return states

    def gradient(
        self,
        segments: Segments,
        x0: Annotated[np.ndarray, "segments size"],
        xi: Annotated[np.ndarray, "weights"],
    ) -> Gradient:
        """Return loss and gradient: the roll-out, then the adjoint backwards (equations 8 and 9)."""
        states = self._rolled(segments, x0, xi)
        measured = self._filled(segments.measured).transpose(1, 0, 2)
        used = (np.arange(self.batch) < segments.count)[:, None]
        scale = 2.0 / segments.steps * self.weight
        adjoint = self._adjoint
        self._load(adjoint, segments, xi)
        total, of_theta = np.zeros(len(xi)), np.zeros(len(self.phi.theta_names))
        costate = np.zeros((self.batch, self.phi.size))
        for k in range(len(states) - 1, 0, -1):
            if k % self.split == 0:
                costate[:, :MEASURED] += scale * used * (states[k, :, :MEASURED] - measured[k // self.split])
            self._load_drive(adjoint, segments, k - 1)
            adjoint.inputs["x"][:] = states[k - 1].T
            adjoint.inputs["costate"][:] = costate.T
            adjoint()
            costate[:] = adjoint.outputs["of_x"].T
            total += adjoint.outputs["of_xi"][0]
            of_theta += adjoint.outputs["of_theta"].sum(1)
        states = states[:: self.split, : segments.count]
        return Gradient(
            loss=loss_of(segments, states, self.weight),
            xi=total,
            x0=costate[: segments.count].copy(),
            theta=of_theta,
        )

    def pushed(self, segments: Segments) -> Pushed:
        """Return roll-outs of these segments, each with its theta and acceleration, without the network."""
        check_split(segments, self.split)

        def roll(x0: np.ndarray, theta: np.ndarray, push: np.ndarray) -> np.ndarray:
            states = roll_out(
                self.phi,
                x0=x0.T,
                drive=segments.drive.transpose(1, 2, 0),
                flight=segments.constants.T,
                theta=theta.T,
                step_s=self.step_s,
                every=self.split,
                push=push.transpose(1, 2, 0),
                rows=self.phi.size,
            )
            return states.transpose(2, 0, 1)

        return roll

    def _filled(self, rows: np.ndarray) -> np.ndarray:
        """Return the rows, filled up to the batch with the first."""
        missing = self.batch - len(rows)
        if missing < 0:
            raise ValueError(f"{len(rows)} segments for a batch of {self.batch}")
        return rows if not missing else np.concatenate([rows, np.repeat(rows[:1], missing, axis=0)])

    def _load(self, function: Buffered, segments: Segments, xi: np.ndarray) -> None:
        function.inputs["xi"][0] = xi
        function.inputs["flight"][:] = self._filled(segments.constants).T

    def _load_drive(self, function: Buffered, segments: Segments, k: int) -> None:
        for half in range(3):
            drive = function.inputs[f"drive{half}"]
            drive[:, : segments.count] = segments.drive[:, 2 * k + half].T
            drive[:, segments.count :] = segments.drive[0, 2 * k + half, :, None]


def loss_of(
    segments: Segments,
    states: Annotated[np.ndarray, "nodes segments size"],
    weight: Annotated[np.ndarray, "12"],
) -> float:
    """Return the sum over segments of the mean weighted squared distance."""
    error = states[1:, :, :MEASURED] - segments.measured[:, 1:].transpose(1, 0, 2)
    return float(np.einsum("ksi,i->", error**2, weight) / segments.steps)


@held_interrupts()
def _adjoint(step: casadi.Function) -> casadi.Function:
    """Return (the step's inputs, costate) -> costate' times its Jacobians by x, xi and each lane's theta."""
    inputs = step.mx_in()
    costate = casadi.MX.sym("costate", *step.size_out("next"))
    product = casadi.dot(costate, step(*inputs))
    of = dict(zip(step.name_in(), inputs, strict=True))
    gradients = [casadi.gradient(product, of[name]) for name in ("x", "xi", "theta")]
    return casadi.Function(
        "adjoint",
        [*inputs, costate],
        gradients,
        [*step.name_in(), "costate"],
        ["of_x", "of_xi", "of_theta"],
    )
