"""Paper Algorithm 1 in CasADi: roll-out (eq. 7), adjoint (eq. 8), gradient (eq. 9) of a batch of segments.

One RK4 step of the hybrid closed loop Phi(x, x_bar, xi) = phi(x, x_bar) + d(x, xi) is an MX function of all
the batch's segments: the network as matrix products over them, the rigid body and the law as an SX function
mapped over them. The adjoint of the step is written out stage by stage; the vector-Jacobian products of phi
and of the network in it are CasADi's reverse mode. phi and its products are compiled where a compiler works.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import casadi
import numpy as np

from host.codegen import compile_function
from host.models.network import Layout
from host.models.phi import DRIVE_ROWS, FLIGHT, Phi
from host.models.segments import Segments

MEASURED = 12
"""States compared with the flight: p, v, Theta, body rate."""


class Buffered:
    """A CasADi function on fixed arrays: write `inputs`, call, read `outputs`, all (columns, rows)."""

    def __init__(self, function: casadi.Function) -> None:
        self.function = function
        # The function, its buffer and the arrays must outlive the trigger: it holds their addresses.
        self._buffer, self._trigger = function.buffer()
        self.inputs: dict[str, np.ndarray] = {}
        self.outputs: dict[str, np.ndarray] = {}
        for i in range(function.n_in()):
            array = np.zeros((function.size2_in(i), function.size1_in(i)))
            self._buffer.set_arg(i, array.reshape(-1).data)  # pyright: ignore[reportCallIssue]
            self.inputs[function.name_in(i)] = array
        for i in range(function.n_out()):
            array = np.zeros((function.size2_out(i), function.size1_out(i)))
            self._buffer.set_res(i, array.reshape(-1).data)  # pyright: ignore[reportCallIssue]
            self.outputs[function.name_out(i)] = array

    def __call__(self) -> None:
        """Compute the outputs from the inputs."""
        self._trigger()


@dataclass(frozen=True, kw_only=True)
class Gradient:
    """Loss and its gradients: of xi (m,), and of each segment's start (segments, size)."""

    loss: float
    xi: np.ndarray
    x0: np.ndarray


class Rollouts:
    """Roll-outs of a batch of segments and their gradient. `weight` (12,): diagonal L of the loss.

    The loss of a segment is the mean over its steps of (x_r - x)' L (x_r - x) (paper eq. 3), the batch's
    their sum. Segments after the batch's end may be filled up with weight 0.
    """

    def __init__(
        self, phi: Phi, layout: Layout, theta: np.ndarray, *, batch: int, step_s: float, weight: np.ndarray
    ) -> None:
        if phi.substeps(step_s) > 1:
            raise ValueError(
                f"a step of {step_s} s is too long for this model: RK4 needs {phi.substeps(step_s)}"
            )
        self.phi, self.layout, self.batch, self.step_s = phi, layout, batch, step_s
        self.weight = np.asarray(weight, dtype=float)
        model = _Model(phi, layout, theta, batch=batch, step_s=step_s)
        self._step = Buffered(model.step())
        self._adjoint = Buffered(model.adjoint())

    def roll_out(self, segments: Segments, x0: np.ndarray, xi: np.ndarray) -> np.ndarray:
        """States (N + 1, batch, size) from the starts x0 (batch, size): equation 7."""
        step = self._step
        states = np.empty((segments.steps + 1, self.batch, self.phi.size))
        states[0] = x0
        self._load(step, segments, xi)
        for k in range(segments.steps):
            self._load_drive(step, segments, k)
            step.inputs["x"][:] = states[k]
            step()
            states[k + 1] = step.outputs["next"]
        return states

    def loss(self, segments: Segments, states: np.ndarray, use: np.ndarray) -> float:
        """Sum over segments of the mean weighted squared distance over their steps; `use` (batch,) 0 or 1."""
        error = states[1:, :, :MEASURED] - self._measured(segments)[1:]
        return float(np.einsum("ksi,i,s->", error**2, self.weight, use) / segments.steps)

    def gradient(self, segments: Segments, x0: np.ndarray, xi: np.ndarray, use: np.ndarray) -> Gradient:
        """Loss and gradient: the roll-out, then the adjoint backwards (equations 8 and 9)."""
        states = self.roll_out(segments, x0, xi)
        measured = self._measured(segments)
        scale = 2.0 / segments.steps * self.weight
        adjoint = self._adjoint
        self._load(adjoint, segments, xi)
        total = np.zeros(len(xi))
        costate = np.zeros((self.batch, self.phi.size))
        for k in range(segments.steps, 0, -1):
            costate[:, :MEASURED] += scale * use[:, None] * (states[k, :, :MEASURED] - measured[k])
            self._load_drive(adjoint, segments, k - 1)
            adjoint.inputs["x"][:] = states[k - 1]
            adjoint.inputs["costate"][:] = costate
            adjoint()
            costate[:] = adjoint.outputs["costate_before"]
            total += adjoint.outputs["gradient"][0]
        return Gradient(loss=self.loss(segments, states, use), xi=total, x0=costate.copy())

    def _measured(self, segments: Segments) -> np.ndarray:
        """(N + 1, batch, 12)."""
        return self._filled(segments.measured).transpose(1, 0, 2)

    def _filled(self, rows: np.ndarray) -> np.ndarray:
        """The rows, the first repeated up to the batch."""
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


class _Model:
    """phi with its network for `batch` segments as MX functions; effects at the values `theta`."""

    def __init__(self, phi: Phi, layout: Layout, theta: np.ndarray, *, batch: int, step_s: float) -> None:
        self.layout, self.step_s = layout, step_s
        self._phi = compile_function(phi.function)[0].map(batch)
        self._products = compile_function(vector_jacobian(phi.function))[0].map(batch)
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
        """(x, drives, flight, xi) -> x one step later, a column a segment."""
        _, rates = self._stages()
        return casadi.Function("step", self.inputs, [self._next(rates)], self.names, ["next"])

    def adjoint(self) -> casadi.Function:
        """(.., costate) -> costate' dPhi/dx and costate' dPhi/dxi: the four stages backwards."""
        h = self.step_s
        x, start, middle, end, flight, xi = self.inputs
        drives = (start, middle, middle, end)
        states, _ = self._stages()
        costate = casadi.MX.sym("costate", x.shape[0], x.shape[1])
        total, gradient, later = costate, 0.0, None
        for stage, weight, reach in ((3, 1.0, 0.0), (2, 2.0, 1.0), (1, 2.0, 0.5), (0, 1.0, 0.5)):
            of_rate = (h * weight / 6.0) * costate
            if later is not None:  # the next stage started from this one's rate
                of_rate = of_rate + h * reach * later
            later, part = self._pull_back(states[stage], drives[stage], flight, xi, of_rate)
            total, gradient = total + later, gradient + part
        return casadi.Function(
            "adjoint",
            [*self.inputs, costate],
            [total, gradient],
            [*self.names, "costate"],
            ["costate_before", "gradient"],
        )

    def _stages(self) -> tuple[list[Any], list[Any]]:
        """States at which RK4 takes its four rates, and the rates."""
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

    def _pull_back(self, x: Any, drive: Any, flight: Any, xi: Any, of_rate: Any) -> tuple[Any, Any]:
        """of_rate' d(rate)/dx, through the network too, and of_rate' d(rate)/dxi."""
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
        of_x, of_residual = self._products(x, drive, flight, self._theta, residual, of_rate)
        of_seen, of_xi = network(xi, x[3:9, :], of_residual)
        return casadi.vertcat(of_x[:3, :], of_x[3:9, :] + of_seen, of_x[9:, :]), of_xi


def vector_jacobian(phi: casadi.Function) -> casadi.Function:
    """phi's inputs and a row l -> l' dphi/dx and l' dphi/d(acceleration), by CasADi's reverse mode."""
    inputs = phi.sx_in()
    row = casadi.SX.sym("row", phi.size1_out(0))
    rate = phi(*inputs)
    products = [casadi.densify(casadi.jtimes(rate, inputs[i], row, True)) for i in (0, 4)]
    return casadi.Function("products", [*inputs, row], casadi.cse(products))
