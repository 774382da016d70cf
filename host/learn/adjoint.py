"""Paper Algorithm 1 in CasADi: roll-out (eq. 7), adjoint (eq. 8), gradient (eq. 9) of a batch of segments.

One RK4 step of the hybrid closed loop Phi(x, x_bar, xi) = phi(x, x_bar) + d(x, xi) is an MX function of all
segments of the batch: the network by matrix products, the rigid body and the law by a mapped SX function. The
adjoint of the step is written stage by stage; CasADi's reverse mode gives the vector-Jacobian products of phi
and of the network. phi and its products are compiled where a compiler works.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated, Any

import casadi
import numpy as np

from trimtab.host.codegen import compile_function
from trimtab.host.codegen.buffered import Buffered
from trimtab.host.learn.kernel import MEASURED, vector_jacobian
from trimtab.host.models.drive import DRIVE_ROWS, FLIGHT
from trimtab.host.models.network import Layout
from trimtab.host.models.phi import Phi
from trimtab.host.models.rollout import roll_out
from trimtab.host.models.segments import Segments

Pushed = Callable[
    [
        Annotated[np.ndarray, "segments size"],
        Annotated[np.ndarray, "segments parameters"],
        Annotated[np.ndarray, "segments stages 3"],
    ],
    Annotated[np.ndarray, "segments nodes size"],
]
"""(x0, theta, push) -> states: a roll-out of segments.

push: an acceleration, NED, at the start, middle and end of each step.
"""


@dataclass(frozen=True, kw_only=True)
class Gradient:
    """Loss and its gradients by xi, theta and each segment's start."""

    loss: float
    xi: Annotated[np.ndarray, "weights"]
    x0: Annotated[np.ndarray, "segments size"]
    theta: Annotated[np.ndarray, "parameters"]


def check_step(phi: Phi, step_s: float) -> None:
    """Raise ValueError if an RK4 step of step_s is not stable."""
    if phi.substeps(step_s) > 1:
        raise ValueError(f"a step of {step_s} s is too long for this model: RK4 needs {phi.substeps(step_s)}")


class Rollouts:
    """Roll-outs of a batch of segments and their gradient. `weight`: diagonal L of the loss.

    The loss of a segment is the mean over its steps of (x_r - x)' L (x_r - x) (paper eq. 3). The loss of the
    batch is the sum over its segments. `engine`: as of `trimtab.host.codegen`.
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
        engine: str | None = None,
    ) -> None:
        check_step(phi, step_s)
        self.phi, self.layout, self.batch, self.step_s = phi, layout, batch, step_s
        self.weight = np.asarray(weight, dtype=float)
        model = _Model(phi, layout, theta, batch=batch, step_s=step_s, engine=engine)
        self._step = Buffered(model.step())
        self._adjoint = Buffered(model.adjoint())

    def roll_out(
        self,
        segments: Segments,
        x0: Annotated[np.ndarray, "segments size"],
        xi: Annotated[np.ndarray, "weights"],
    ) -> Annotated[np.ndarray, "nodes segments size"]:
        """Return the states from the starts x0: equation 7."""
        return self._rolled(segments, x0, xi)[:, : segments.count]

    def _rolled(self, segments: Segments, x0: np.ndarray, xi: np.ndarray) -> np.ndarray:
        """Return the states of the whole batch, filled up with the first segment."""
        step = self._step
        states = np.empty((segments.steps + 1, self.batch, self.phi.size))
        states[0] = self._filled(x0)
        self._load(step, segments, xi)
        for k in range(segments.steps):
            self._load_drive(step, segments, k)
            step.inputs["x"][:] = states[k]
            step()
            states[k + 1] = step.outputs["next"]
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
        for k in range(segments.steps, 0, -1):
            costate[:, :MEASURED] += scale * used * (states[k, :, :MEASURED] - measured[k])
            self._load_drive(adjoint, segments, k - 1)
            adjoint.inputs["x"][:] = states[k - 1]
            adjoint.inputs["costate"][:] = costate
            adjoint()
            costate[:] = adjoint.outputs["costate_before"]
            total += adjoint.outputs["gradient"][0]
            of_theta += adjoint.outputs["theta"][0, : len(of_theta)]
        states = states[:, : segments.count]
        return Gradient(
            loss=loss_of(segments, states, self.weight),
            xi=total,
            x0=costate[: segments.count].copy(),
            theta=of_theta,
        )

    def pushed(self, segments: Segments) -> Pushed:
        """Return roll-outs of these segments, each with its theta and acceleration, without the network."""

        def roll(x0: np.ndarray, theta: np.ndarray, push: np.ndarray) -> np.ndarray:
            states = roll_out(
                self.phi,
                x0=x0.T,
                drive=segments.drive.transpose(1, 2, 0),
                flight=segments.constants.T,
                theta=theta.T,
                step_s=self.step_s,
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
        function.inputs["flight"][:] = self._filled(segments.constants)

    def _load_drive(self, function: Buffered, segments: Segments, k: int) -> None:
        for i, name in enumerate(("drive_start", "drive_middle", "drive_end")):
            rows = function.inputs[name]
            rows[: segments.count] = segments.drive[:, 2 * k + i]
            rows[segments.count :] = segments.drive[0, 2 * k + i]


def loss_of(
    segments: Segments,
    states: Annotated[np.ndarray, "nodes segments size"],
    weight: Annotated[np.ndarray, "12"],
) -> float:
    """Return the sum over segments of the mean weighted squared distance."""
    error = states[1:, :, :MEASURED] - segments.measured[:, 1:].transpose(1, 0, 2)
    return float(np.einsum("ksi,i->", error**2, weight) / segments.steps)


class _Model:
    """phi with its network for `batch` segments as MX functions; effects at the values `theta`."""

    def __init__(
        self, phi: Phi, layout: Layout, theta: np.ndarray, *, batch: int, step_s: float, engine: str | None
    ) -> None:
        self.layout, self.step_s = layout, step_s
        self._phi = compile_function(phi.function, engine=engine)[0].map(batch)
        self._products = compile_function(vector_jacobian(phi.function), engine=engine)[0].map(batch)
        self._theta = casadi.repmat(casadi.DM(theta), 1, batch)
        drives = [
            casadi.MX.sym(name, DRIVE_ROWS[phi.drive], batch)
            for name in ("drive_start", "drive_middle", "drive_end")
        ]
        self.inputs = [
            casadi.MX.sym("x", phi.size, batch),
            *drives,
            casadi.MX.sym("flight", len(FLIGHT), batch),
            casadi.MX.sym("xi", layout.size),
        ]
        self.names = [symbol.name() for symbol in self.inputs]

    def step(self) -> casadi.Function:
        """Return (x, drives, flight, xi) -> x one step later, with a column for each segment."""
        _, rates = self._stages()
        return casadi.Function("step", self.inputs, [self._next(rates)], self.names, ["next"])

    def adjoint(self) -> casadi.Function:
        """Return (.., costate) -> costate' dPhi/dx and costate' dPhi/dxi: the four stages backwards."""
        h = self.step_s
        x, start, middle, end, flight, xi = self.inputs
        drives = (start, middle, middle, end)
        states, _ = self._stages()
        costate = casadi.MX.sym("costate", x.shape[0], x.shape[1])
        total, gradient, of_theta, later = costate, 0.0, 0.0, None
        for stage, weight, reach in ((3, 1.0, 0.0), (2, 2.0, 1.0), (1, 2.0, 0.5), (0, 1.0, 0.5)):
            of_rate = (h * weight / 6.0) * costate
            if later is not None:  # the next stage started from this one's rate
                of_rate = of_rate + h * reach * later
            later, part, theta = self._pull_back(states[stage], drives[stage], flight, xi, of_rate)
            total, gradient, of_theta = total + later, gradient + part, of_theta + theta
        return casadi.Function(
            "adjoint",
            [*self.inputs, costate],
            [total, gradient, of_theta],
            [*self.names, "costate"],
            ["costate_before", "gradient", "theta"],
        )

    def _stages(self) -> tuple[list[Any], list[Any]]:
        """Return the states at which RK4 evaluates its four rates, and the rates."""
        h = self.step_s
        x, start, middle, end, flight, xi = self.inputs
        states, rates = [x], [self._rate(x, start, flight, xi)]
        for drive, reach in ((middle, 0.5), (middle, 0.5), (end, 1.0)):
            states.append(x + h * reach * rates[-1])
            rates.append(self._rate(states[-1], drive, flight, xi))
        return states, rates

    def _next(self, rates: list[Any]) -> Any:
        k1, k2, k3, k4 = rates
        return self.inputs[0] + self.step_s / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)

    def _rate(self, x: Any, drive: Any, flight: Any, xi: Any) -> Any:
        return self._phi(x, drive, flight, self._theta, self.layout.matrices(xi, x[3:9, :]))

    def _pull_back(self, x: Any, drive: Any, flight: Any, xi: Any, of_rate: Any) -> tuple[Any, Any, Any]:
        """Return of_rate' times d(rate)/dx, network included, d(rate)/dxi and d(rate)/dtheta."""
        seen = casadi.MX.sym("seen", *x[3:9, :].shape)
        weights = casadi.MX.sym("weights", self.layout.size)
        push = casadi.MX.sym("push", 3, seen.shape[1])
        product = casadi.dot(push, self.layout.matrices(weights, seen))
        network = casadi.Function(
            "network",
            [weights, seen, push],
            [casadi.gradient(product, seen), casadi.gradient(product, weights)],
        )
        residual = self.layout.matrices(xi, x[3:9, :])
        of_x, of_residual, of_theta = self._products(x, drive, flight, self._theta, residual, of_rate)
        of_seen, of_xi = network(xi, x[3:9, :], of_residual)
        of_x = casadi.vertcat(of_x[:3, :], of_x[3:9, :] + of_seen, of_x[9:, :])
        return of_x, of_xi, casadi.sum2(of_theta)
