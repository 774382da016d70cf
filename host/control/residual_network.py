"""The network of a model with its Jacobian as CasADi functions, in a form that compiles to fast code.

The weights are laid out as matrices once for all evaluations of a prediction. The Jacobian is accumulated
from the outputs, because there are fewer of them than inputs. Every product has an operand with a structural
zero: CasADi then adds up columns, which a compiler vectorises, instead of rows, one sum at a time.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import casadi as ca

from trimtab.host.codegen import CASADI
from trimtab.host.control.dynamics import NETWORK_STATE
from trimtab.host.models.network import Layout, Network

_SIZE = NETWORK_STATE.stop - NETWORK_STATE.start


@dataclass(frozen=True, kw_only=True)
class NetworkFunctions:
    """Functions of a network; without one, its acceleration is zero.

    matrices(xi) -> matrices. value(matrices, v_ned and Theta) -> acceleration (3).
    slopes(matrices, v_ned and Theta) -> acceleration (3), Jacobian (3, 6).
    """

    matrices: ca.Function
    value: ca.Function
    slopes: ca.Function


def network_functions(network: Network | None) -> NetworkFunctions:
    """Return the functions of a network, or those of none."""
    state = ca.MX.sym("state", _SIZE)
    if network is None:
        xi, zero, slopes = ca.MX.sym("xi", 0), ca.MX(ca.DM.zeros(3)), ca.MX(ca.DM.zeros(3, _SIZE))
        return NetworkFunctions(
            matrices=ca.Function("network_matrices", [xi], []),
            value=ca.Function("network", [state], [zero]),
            slopes=ca.Function("network_slopes", [state], [zero, slopes]),
        )
    layout = network.layout
    xi = ca.MX.sym("xi", layout.size)
    matrices = _matrices(layout, xi)
    symbols = [ca.MX.sym(f"W{k}", *matrix.shape) for k, matrix in enumerate(matrices)]
    edges = _Edges(layout)
    activations, outputs = _activations(edges, symbols, state)
    value = edges.acceleration(state, outputs)[0]
    options = {"cse": True}
    return NetworkFunctions(
        matrices=ca.Function("network_matrices", [xi], matrices),
        value=ca.Function("network", [*symbols, state], [value], options),
        slopes=ca.Function(
            "network_slopes",
            [*symbols, state],
            [value, _jacobian(edges, symbols, state, activations, outputs)],
            options,
        ),
    )


class _Edges:
    """What surrounds the layers: inputs and acceleration by frame, with their Jacobians."""

    def __init__(self, layout: Layout) -> None:
        state, outputs = ca.SX.sym("state", _SIZE), ca.SX.sym("outputs", 3)
        rows = ca.vertsplit(state)
        inputs = ca.vertcat(*layout.inputs(CASADI, rows))
        acceleration = ca.vertcat(*layout.acceleration(CASADI, rows, ca.vertsplit(outputs)))
        self.inputs = _function("network_inputs", [state], [inputs, ca.jacobian(inputs, state)])
        self.acceleration = _function(
            "network_acceleration",
            [state, outputs],
            [acceleration, ca.jacobian(acceleration, state), ca.jacobian(acceleration, outputs)],
        )


def _function(name: str, inputs: list[ca.SX], outputs: list[ca.SX]) -> ca.Function:
    return ca.Function(name, inputs, [ca.densify(output) for output in outputs], {"cse": True})


def _matrices(layout: Layout, xi: ca.MX) -> list[ca.MX]:
    """Return two matrices a layer: rows by inputs, the bias last, and the transposed one."""
    matrices = []
    for place in layout.places():
        transposed = ca.reshape(xi[place.where], place.columns, place.rows)
        matrices += [transposed.T, transposed]
    return matrices


def _activations(edges: _Edges, matrices: Sequence[ca.MX], state: ca.MX) -> tuple[list[ca.MX], ca.MX]:
    """Return the values that enter each layer but the first, and the outputs of the last."""
    values, entering = edges.inputs(state)[0], []
    for k, matrix in enumerate(matrices[::2]):
        if k:
            values = ca.tanh(values)
            entering.append(values)
        values = matrix @ ca.vertcat(values, ca.MX(1, 1)) + matrix[:, -1]
    return entering, values


def _jacobian(
    edges: _Edges, matrices: Sequence[ca.MX], state: ca.MX, activations: Sequence[ca.MX], outputs: ca.MX
) -> ca.MX:
    """Return the Jacobian (3, 6) of the acceleration in the state."""
    _, direct, by_outputs = edges.acceleration(state, outputs)
    adjoint = by_outputs.T
    for k, transposed in reversed(list(enumerate(matrices[1::2]))):
        adjoint = (transposed @ ca.horzcat(adjoint, ca.MX(adjoint.shape[0], 1)))[:-1, :3]
        if k:
            slope = 1.0 - activations[k - 1] * activations[k - 1]
            adjoint = adjoint * ca.repmat(slope, 1, 3)
    return direct + adjoint.T @ edges.inputs(state)[1]
