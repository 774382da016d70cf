"""The learned residual: a small tanh network from velocity and attitude to an acceleration (paper IV-A).

The paper's network maps [v_ned, Theta] to the acceleration in NED. A network in the body's frame maps the
velocity in FRD to the acceleration in FRD, so it is the same for every heading. The weights are one flat
vector xi in the law's order: layer by layer, for every neuron the weights of its inputs, then its bias. The
same network runs on scalars (the law's form), as CasADi matrix products and on numpy arrays.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Annotated, Any, Literal, NamedTuple

import casadi
import numpy as np

from trimtab.firmware_model.law.feedforward import NETWORK_INPUTS, NETWORK_OUTPUTS, network, weight_count
from trimtab.firmware_model.law.ops import Ops
from trimtab.firmware_model.law.rotations import euler_to_matrix, mat_t_vec, mat_vec
from trimtab.host.codegen.ops import CASADI, NUMPY

Frame = Literal["world", "body"]


@dataclass(frozen=True, kw_only=True)
class Layout:
    """The shape of a network: widths of the hidden layers between 6 or 3 inputs and 3 outputs.

    In the world's frame the inputs are v_ned, roll, pitch and yaw, with yaw wrapped to -pi..pi. In the body's
    frame they are the velocity in FRD.

    Raises ValueError for more than three layers of 32, the most that the vehicle can hold.
    """

    hidden: tuple[int, ...]
    frame: Frame = "world"

    def __post_init__(self) -> None:
        weight_count(self.hidden)

    @property
    def sizes(self) -> tuple[int, ...]:
        """Width of every layer, inputs and outputs included."""
        return (NETWORK_INPUTS if self.frame == "world" else 3, *self.hidden, NETWORK_OUTPUTS)

    @property
    def size(self) -> int:
        """Number of weights."""
        return weight_count(self.hidden, self.sizes[0])

    def initial(self, rng: np.random.Generator) -> Annotated[np.ndarray, "weights"]:
        """Return random first weights: normal over the square root of the fan-in, a tenth in the last layer.

        Biases are 0. With the small last layer the residual starts near zero, and early roll-outs stay close
        to the nominal model.
        """
        xi = np.zeros(self.size)
        layers = list(self.places())
        for layer in layers:
            scale = (0.1 if layer is layers[-1] else 1.0) / math.sqrt(layer.columns - 1)
            weights = xi[layer.where].reshape(layer.rows, layer.columns)
            weights[:, :-1] = scale * rng.standard_normal((layer.rows, layer.columns - 1))
        return xi

    def inputs(self, ops: Ops, state: Sequence[Any]) -> list[Any]:
        """Return the network's inputs for v_ned and Theta, 6 scalars."""
        if self.frame == "body":
            return list(mat_t_vec(euler_to_matrix(ops, state[3:6]), state[0:3]))
        return [*state[0:5], ops.atan2(ops.sin(state[5]), ops.cos(state[5]))]

    def acceleration(self, ops: Ops, state: Sequence[Any], outputs: Sequence[Any]) -> list[Any]:
        """Return the acceleration, NED, for the network's outputs at v_ned and Theta `state`."""
        if self.frame == "body":
            return list(mat_vec(euler_to_matrix(ops, state[3:6]), outputs))
        return list(outputs)

    def outputs(self, ops: Ops, state: Sequence[Any], acceleration_ned: Sequence[Any]) -> list[Any]:
        """Return the outputs for an acceleration, NED: the inverse, and transpose, of `acceleration`."""
        if self.frame == "body":
            return list(mat_t_vec(euler_to_matrix(ops, state[3:6]), acceleration_ned))
        return list(acceleration_ned)

    def scalars(self, ops: Ops, xi: Sequence[Any], state: Sequence[Any]) -> Sequence[Any]:
        """Return the acceleration (3,) for v_ned and Theta, 6 scalars, by the law's form."""
        return self.acceleration(ops, state, network(ops, xi, self.hidden, self.inputs(ops, state), ()))

    def matrices(self, xi: Any, state: Any) -> Any:
        """Return accelerations (3, n) for v_ned and Theta (6, n) by CasADi matrix products, MX or SX."""
        rows = casadi.vertsplit(state)
        values = casadi.vertcat(*self.inputs(CASADI, rows))
        ones = casadi.DM.ones(1, state.shape[1])
        for k, layer in enumerate(self.places()):
            if k:
                values = casadi.tanh(values)
            weights = casadi.reshape(xi[layer.where], layer.columns, layer.rows).T  # CasADi: columns first
            values = casadi.mtimes(weights, casadi.vertcat(values, ones))
        return casadi.vertcat(*self.acceleration(CASADI, rows, casadi.vertsplit(values)))

    def arrays(
        self, xi: Annotated[np.ndarray, "weights"], state: Annotated[np.ndarray, "6 lanes"]
    ) -> Annotated[np.ndarray, "3 lanes"]:
        """Return accelerations for v_ned and Theta on numpy."""
        return self.with_vjp(xi, state)[0]

    def with_vjp(
        self, xi: Annotated[np.ndarray, "weights"], state: Annotated[np.ndarray, "6 lanes"]
    ) -> tuple[Annotated[np.ndarray, "3 lanes"], Callable[[np.ndarray], np.ndarray]]:
        """Return the accelerations of `arrays`, and a function that pulls a costate (3, lanes) back to xi.

        The function returns costate' d(acceleration)/dxi, (weights,).
        """
        rows = list(state)
        values, layer_inputs = np.stack(self.inputs(NUMPY, rows)), []
        layers = list(self.places())
        for k, layer in enumerate(layers):
            if k:
                np.tanh(values, out=values)
            layer_inputs.append(values)
            weights = xi[layer.where].reshape(layer.rows, layer.columns)
            values = weights[:, :-1] @ values
            values += weights[:, -1:]

        def vjp(costate: np.ndarray) -> np.ndarray:
            back, gradient = np.stack(self.outputs(NUMPY, rows, list(costate))), np.empty(self.size)
            for k, layer in reversed(list(enumerate(layers))):
                layer_gradient = gradient[layer.where].reshape(layer.rows, layer.columns)
                np.matmul(back, layer_inputs[k].T, out=layer_gradient[:, :-1])
                layer_gradient[:, -1] = back.sum(1)
                if k:
                    weights = xi[layer.where].reshape(layer.rows, layer.columns)
                    back = (weights[:, :-1].T @ back) * (1.0 - layer_inputs[k] * layer_inputs[k])
            return gradient

        return np.stack(self.acceleration(NUMPY, rows, list(values))), vjp

    def layers(
        self, xi: Annotated[np.ndarray, "weights"]
    ) -> list[tuple[Annotated[np.ndarray, "outputs inputs"], Annotated[np.ndarray, "outputs"]]]:
        """Return weights and biases of every layer; the last is linear."""
        matrices = [xi[layer.where].reshape(layer.rows, layer.columns) for layer in self.places()]
        return [(rows[:, :-1], rows[:, -1]) for rows in matrices]

    def places(self) -> Iterator[LayerPlace]:
        """Yield the place of every layer's weights; each row ends with its bias."""
        start = 0
        for inputs, outputs in pairwise(self.sizes):
            stop = start + outputs * (inputs + 1)
            yield LayerPlace(slice(start, stop), outputs, inputs + 1)
            start = stop


class LayerPlace(NamedTuple):
    """Place of a layer's weights in xi, and its rows and columns; each row ends with its bias."""

    where: slice
    rows: int
    columns: int


@dataclass(frozen=True, kw_only=True, eq=False)
class Network:
    """A layout with its weights xi, `layout.size` finite numbers; read-only."""

    layout: Layout
    xi: Annotated[np.ndarray, "weights"]

    def __post_init__(self) -> None:
        xi = np.array(self.xi, dtype=float)
        if xi.shape != (self.layout.size,):
            raise ValueError(f"a network {self.layout.sizes} has {self.layout.size} weights, got {xi.shape}")
        if not np.isfinite(xi).all():
            raise ValueError("network weights must be finite")
        xi.setflags(write=False)
        object.__setattr__(self, "xi", xi)

    def acceleration_ned(
        self, v_ned: Annotated[np.ndarray, "3 lanes"], theta: Annotated[np.ndarray, "3 lanes"]
    ) -> Annotated[np.ndarray, "3 lanes"]:
        """Return the residual acceleration, m/s^2 NED, for velocities and Euler angles."""
        return self.layout.arrays(self.xi, np.concatenate([v_ned, theta]))
