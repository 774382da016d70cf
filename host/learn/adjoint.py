"""Paper Algorithm 1 in CasADi: roll-out (eq. 7), adjoint (eq. 8), gradient (eq. 9) of a batch of segments.

One RK4 step of the hybrid closed loop Phi(x, x_bar, xi) = phi(x, x_bar) + d(x, xi) is an MX function of all
the batch's segments: the network as matrix products over them, the rigid body and the law as an SX function
mapped over them. Its vector-Jacobian product comes from CasADi's reverse mode; the recursion over the steps
is ours.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import casadi
import numpy as np

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
        step = step_function(phi, layout, theta, batch=batch, step_s=step_s)
        self._step = Buffered(step)
        self._adjoint = Buffered(adjoint_function(step))

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


def step_function(
    phi: Phi, layout: Layout, theta: np.ndarray, *, batch: int, step_s: float
) -> casadi.Function:
    """One RK4 step of the hybrid model for `batch` segments as an MX function, effects at `theta`."""
    mapped = phi.function.map(batch)
    rows = DRIVE_ROWS[phi.drive]
    x = casadi.MX.sym("x", phi.size, batch)
    names = ("drive_start", "drive_middle", "drive_end")
    start, middle, end = (casadi.MX.sym(name, rows, batch) for name in names)
    flight = casadi.MX.sym("flight", len(FLIGHT), batch)
    xi = casadi.MX.sym("xi", layout.size)
    values = casadi.repmat(casadi.DM(theta), 1, batch)

    def rate(state: Any, drive: Any) -> Any:
        return mapped(state, drive, flight, values, layout.matrices(xi, state[3:9, :]))

    h = step_s
    k1 = rate(x, start)
    k2 = rate(x + 0.5 * h * k1, middle)
    k3 = rate(x + 0.5 * h * k2, middle)
    k4 = rate(x + h * k3, end)
    following = x + h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
    inputs = [x, start, middle, end, flight, xi]
    return casadi.Function("step", inputs, [following], ["x", *names, "flight", "xi"], ["next"])


def adjoint_function(step: casadi.Function) -> casadi.Function:
    """The step's vector-Jacobian products: costate' dPhi/dx (a column a segment) and costate' dPhi/dxi."""
    inputs = step.mx_in()
    costate = casadi.MX.sym("costate", step.size1_out(0), step.size2_out(0))
    product = casadi.dot(costate, step(*inputs))
    names = [step.name_in(i) for i in range(step.n_in())]
    x, xi = inputs[0], inputs[-1]
    outputs = [casadi.gradient(product, x), casadi.gradient(product, xi)]
    return casadi.Function(
        "adjoint", [*inputs, costate], outputs, [*names, "costate"], ["costate_before", "gradient"]
    )
