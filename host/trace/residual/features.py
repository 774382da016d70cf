"""The disturbance in bins of 0.1 s, and the quantities that it may depend on."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np

from trimtab.host.trace.data.segments import BIN_S, Segments
from trimtab.host.trace.data.signals import nominal_thrust
from trimtab.host.trace.decision.rules import RULES
from trimtab.host.vehicle import Vehicle

_CENTRES = 16
"""Gaussians of the radial basis of position."""


@dataclass(frozen=True, kw_only=True)
class Bins:
    """The disturbance and the quantities that it may depend on, with one row for each bin of 0.1 s.

    Attributes
    ----------
    segment, flight, reference
        Numbers of segment, flight and reference.
    t_s
        Time since tracking began.
    w
        Disturbance, FRD: specific force in m/s^2, then angular acceleration in rad/s^2.
    R
        R_ned_frd.
    p, v
        Position in m and velocity in m/s, NED.
    rate
        Body rate in rad/s, FRD.
    rotors
        Commanded thrust of each rotor over the vehicle's mass, m/s^2.
    """

    segment: Annotated[np.ndarray, "rows"]
    flight: Annotated[np.ndarray, "rows"]
    reference: Annotated[np.ndarray, "rows"]
    t_s: Annotated[np.ndarray, "rows"]
    w: Annotated[np.ndarray, "rows 6"]
    R: Annotated[np.ndarray, "rows 3 3"]
    p: Annotated[np.ndarray, "rows 3"]
    v: Annotated[np.ndarray, "rows 3"]
    rate: Annotated[np.ndarray, "rows 3"]
    rotors: Annotated[np.ndarray, "rows 4"]

    @property
    def force_ned(self) -> Annotated[np.ndarray, "rows 3"]:
        """Disturbance force in m/s^2, NED."""
        return np.einsum("nij,nj->ni", self.R, self.w[:, :3])

    @property
    def v_frd(self) -> Annotated[np.ndarray, "rows 3"]:
        """Velocity in m/s, FRD."""
        return np.einsum("nij,ni->nj", self.R, self.v)


def bins_of(
    w: Annotated[np.ndarray, "segments bins 6"],
    data: Segments,
    references: Sequence[str | None],
    vehicle: Vehicle,
) -> Bins:
    """Return the rows of a disturbance.

    w: disturbance, FRD. data: its segments. references: id of the reference of each flight, None where it is
    unknown.
    """
    count, bins, _ = w.shape
    per_bin = data.steps // bins
    middle = per_bin // 2

    def means(values: np.ndarray) -> np.ndarray:
        return values.reshape(count, bins, per_bin, -1).mean(2).reshape(count * bins, -1)

    names = [name or f"flight {index}" for index, name in enumerate(references)]
    number = {name: k for k, name in enumerate(dict.fromkeys(names))}
    command = data.command[:, -data.steps :]
    rotors = nominal_thrust(vehicle, command, in_newton=data.in_newton)
    start = np.repeat(data.start_s, bins)
    flight = np.repeat(data.flight, bins)
    return Bins(
        segment=np.repeat(np.arange(count), bins),
        flight=flight,
        reference=np.array([number[name] for name in names])[flight],
        t_s=start + np.tile(BIN_S * (np.arange(bins) + 0.5), count),
        w=w.reshape(-1, 6),
        R=data.R_ned_frd.reshape(count, bins, per_bin, 9)[:, :, middle].reshape(-1, 3, 3),
        p=means(data.p_ned),
        v=means(np.gradient(data.p_ned, data.dt_s, axis=1)),
        rate=means(data.rate_frd),
        rotors=means(rotors) / vehicle.mass_kg,
    )


def features_of(bins: Bins) -> dict[str, tuple[np.ndarray, tuple[str, ...], str, bool]]:
    """Return the groups of quantities by name: (basis, names, unit, natural).

    basis (rows, functions): its first columns are the quantities themselves, the others nonlinear functions
    of them. names: of these first columns. unit: of all of them. natural: whether a force that depends on the
    group is described in world axes, not in body axes.
    """
    up = bins.R[:, 2, :]
    collective = bins.rotors.sum(1)
    yaw = np.arctan2(bins.R[:, 1, 0], bins.R[:, 0, 0])
    # Differences of front and rear, of left and right, and of the diagonals, for any order of the rotors.
    differences = (
        bins.rotors @ np.array([[1.0, 1.0, -1.0, -1.0], [1.0, -1.0, 1.0, -1.0], [1.0, -1.0, -1.0, 1.0]]).T
    )
    order = bins.flight.astype(float)
    t = bins.t_s
    v, attitude, angles = bins.v_frd, up[:, :2], ("tilt x", "tilt y")
    if np.abs(np.exp(1j * yaw).mean()) < RULES.one_heading:
        attitude = np.column_stack([attitude, np.cos(yaw), np.sin(yaw)])
        angles = (*angles, "cos heading", "sin heading")
    speed = np.linalg.norm(v, axis=1, keepdims=True)
    body = ("x", "y", "z")
    return {
        "position": (
            np.column_stack([bins.p, _squares(bins.p), _bumps(bins.p)]),
            ("north", "east", "down"), "m", True,
        ),
        "time": (
            np.column_stack([t, order, _squares(np.column_stack([t, order]))]),
            ("time", "the flights' order"), "s", True,
        ),
        "body velocity": (
            np.column_stack([v, _squares(v), speed * v]),
            tuple(f"velocity {axis}" for axis in body), "(m/s)", False,
        ),
        "attitude": (
            np.column_stack([attitude, _squares(attitude)]), angles, "rad", False,
        ),
        "body rate": (
            np.column_stack([bins.rate, _squares(bins.rate)]),
            tuple(f"rate {axis}" for axis in body), "(rad/s)", False,
        ),
        "thrust": (
            np.column_stack([collective, differences, _squares(np.column_stack([collective, differences]))]),
            ("collective thrust", "thrust 1+2-3-4", "thrust 1-2+3-4", "thrust 1-2-3+4"), "(m/s^2)", False,
        ),
    }  # fmt: skip


def _squares(x: np.ndarray) -> np.ndarray:
    """Return all products (rows, m (m + 1) / 2) of two columns of x (rows, m), squares included."""
    first, second = np.triu_indices(x.shape[1])
    return x[:, first] * x[:, second]


def _bumps(p: np.ndarray) -> np.ndarray:
    """Return Gaussians (rows, centres) of positions p (rows, 3); the centres are as far apart as possible.

    The standard deviation is about the spacing of the centres, but at least 0.1 m.
    """
    centres = [int(np.linalg.norm(p - p.mean(0), axis=1).argmin())]
    distance = np.full(len(p), np.inf)
    while len(centres) < min(_CENTRES, len(p)):
        distance = np.minimum(distance, np.linalg.norm(p - p[centres[-1]], axis=1))
        centres.append(int(distance.argmax()))
    width = max(float(distance.max()), 0.1)
    from_centre = np.linalg.norm(p[:, None] - p[centres], axis=2)
    return np.exp(-0.5 * (from_centre / width) ** 2)


def constant_columns(bins: Bins, world: bool) -> Annotated[np.ndarray, "rows 3 regressors"]:
    """Return columns, FRD, of disturbances constant in body axes and, if `world`, in NED."""
    ones = np.ones((len(bins.w), 1))
    body = columns_of(ones, None)
    return np.concatenate([body, columns_of(ones, bins.R)], axis=2) if world else body


def columns_of(
    basis: Annotated[np.ndarray, "rows functions"], R: Annotated[np.ndarray, "rows 3 3"] | None
) -> Annotated[np.ndarray, "rows 3 regressors"]:
    """Return columns, FRD, of a basis along each axis.

    The axes are those of the body, or of NED if R, R_ned_frd, is given.
    """
    axes = np.eye(3)[None] if R is None else np.swapaxes(R, 1, 2)
    product = basis[:, None, :, None] * axes[:, :, None, :]
    return product.reshape(len(basis), 3, -1)


def standardised(basis: Annotated[np.ndarray, "rows functions"]) -> Annotated[np.ndarray, "rows functions"]:
    """Return the columns of a basis with zero mean and unit variance."""
    return (basis - basis.mean(0)) / np.maximum(basis.std(0), 1e-9)
