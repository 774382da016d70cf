"""The parameter space of two sets of flights: what they have in common, and what differs in the second set.

A flight of the baseline is predicted with theta_common, a flight after the change with theta_common +
theta_difference. Roll-outs take the parameters of one flight (`JointSpace.rolled`), so the slopes of a flight
are computed once and then assigned to the common and the difference columns.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Annotated

import numpy as np

from trimtab.host.effects import Effect
from trimtab.host.effects.unknowns import THRUST, THRUST_CURVE, TORQUE
from trimtab.host.trace.bounds import with_added
from trimtab.host.trace.decision.rules import RULES
from trimtab.host.trace.parameters import Column, ParameterSpace, space
from trimtab.host.vehicle import Vehicle

COMMON = "common "
"""Prefix of the owners of common columns; the owner of a difference column is its effect."""


@dataclass(frozen=True, kw_only=True)
class JointSpace(ParameterSpace):
    """Common columns of all flights, and difference columns of the flights after the change.

    All common columns are adjustments and freed. The candidates are differences. The bounds of a difference
    column are those of the sum, which is the value in the flights after the change.

    Attributes
    ----------
    one_flight
        Parameters of the roll-out of one flight, with the same nuisances.
    index
        For each column: index of the parameter of `one_flight` to which it adds.
    after
        For each flight: whether it is one after the change. None: every flight is.
    """

    one_flight: ParameterSpace
    index: tuple[int, ...]
    after: tuple[bool, ...] | None = None

    def __post_init__(self) -> None:
        if len(self.index) != len(self.columns):
            raise ValueError(f"{len(self.index)} indices for {len(self.columns)} columns")

    @property
    def rolled(self) -> ParameterSpace:
        """Parameters of the roll-outs: those of one flight."""
        return self.one_flight

    @cached_property
    def is_common(self) -> Annotated[np.ndarray, "columns"]:
        """Which columns act in every flight."""
        return np.array([column.owner.startswith(COMMON) for column in self.columns])

    @cached_property
    def forms(self) -> dict[str, tuple[int, ...]]:
        """No column: forms may differ if a common effect acts, so none is fixed if no difference is selected.

        A weight, for example, moves the centre of mass, and so the height of the drag above it.
        """
        return dict.fromkeys(self.groups, ())

    @cached_property
    def added(self) -> Annotated[np.ndarray, "columns"]:
        """Index of the common column of the same parameter for each difference column; -1 for none."""
        common = {self.index[i]: i for i in np.flatnonzero(self.is_common).tolist()}
        return np.array(
            [
                -1 if is_common else common.get(index, -1)
                for index, is_common in zip(self.index, self.is_common, strict=True)
            ]
        )

    def acting(self, flight: int) -> Annotated[np.ndarray, "columns"]:
        """Return which columns act in a flight."""
        return np.ones_like(self.is_common) if self.after is None or self.after[flight] else self.is_common

    def matrix(self, flight: int) -> Annotated[np.ndarray, "parameters columns"]:
        """Return the matrix from the columns to the parameters of the roll-out of a flight."""
        M = np.zeros((len(self.rolled.columns), len(self.columns)))
        M[self.index, np.arange(len(self.columns))] = self.acting(flight)
        return M

    def of_flight(
        self, theta_scaled: Annotated[np.ndarray, "columns"], flight: int
    ) -> Annotated[np.ndarray, "parameters"]:
        """Return the scaled parameters of the roll-out of a flight."""
        return self.matrix(flight) @ theta_scaled

    def clipped(self, theta_scaled: Annotated[np.ndarray, "columns"]) -> Annotated[np.ndarray, "columns"]:
        """Return theta_scaled with sums clipped to the bounds."""
        sums = super().clipped(with_added(theta_scaled, self.added))
        return with_added(sums, self.added, -1.0)

    def at_bound(self, theta_scaled: Annotated[np.ndarray, "columns"]) -> Annotated[np.ndarray, "columns"]:
        """Return the mask of columns whose sum is at a bound other than neutral."""
        return super().at_bound(with_added(theta_scaled, self.added))

    def after_change(self) -> JointSpace:
        """Return the space for flights that are all after the change."""
        return replace(self, after=None)

    def expanded(
        self, gram: Annotated[np.ndarray, "segments all all"], flight: int
    ) -> Annotated[np.ndarray, "segments all_columns all_columns"]:
        """Return Grams of [r | parameters | others] as Grams of [r | columns | others]."""
        count = 1 + len(self.rolled.columns)
        others = np.arange(count, gram.shape[1])
        taken = np.concatenate([[0], 1 + np.array(self.index), others])
        acting = np.concatenate([[True], self.acting(flight), np.ones(len(others), dtype=bool)])
        return gram[:, taken[:, None], taken] * np.outer(acting, acting)

    def active(self, theta_scaled: Annotated[np.ndarray, "columns"]) -> Annotated[np.ndarray, "active"]:
        """Return the indices of the parameters of `rolled` whose slopes a flight needs."""
        one_of_each = {kind: flight for flight, kind in enumerate(self.after or (True,))}.values()
        active = [self.rolled.active(self.of_flight(theta_scaled, flight)) for flight in one_of_each]
        return np.unique(np.concatenate(active))

    def mapped(
        self,
        theta_scaled: Annotated[np.ndarray, "columns"],
        covariance: Annotated[np.ndarray, "columns columns"],
    ) -> tuple[Annotated[np.ndarray, "parameters"], Annotated[np.ndarray, "parameters parameters"]]:
        """Return estimate and covariance, scaled, of the parameters after the change."""
        M = self.after_change().matrix(0)
        return M @ theta_scaled, M @ covariance @ M.T


def joint_space(
    vehicle: Vehicle,
    effects: Mapping[str, Effect],
    unknown: Iterable[str],
    after: Sequence[bool],
    *,
    thrust_commanded: bool = False,
) -> JointSpace:
    """Return the joint space of two sets of flights.

    Parameters
    ----------
    vehicle, effects, unknown, thrust_commanded
        As for `trimtab.host.trace.parameters.space`.
    after
        For each flight: whether it is one after the change.
    """
    unknown = frozenset(unknown)
    common = space(vehicle, effects, unknown, thrust_commanded=thrust_commanded)
    hidden = unknown & {THRUST, TORQUE}  # what else is unknown, both sets have in common
    bounded = {(column.owner, column.key): column for column in common.columns}
    differences = [
        replace(column, lower=bound.lower, upper=bound.upper)
        for column in space(vehicle, effects, hidden, thrust_commanded=thrust_commanded).columns
        for bound in (bounded.get((column.owner, column.key), column),)
    ]
    curve = [column for column in common.columns if column.owner not in effects]
    rolled = replace(
        common,
        columns=(*differences, *curve),
        candidates=(),
        freed=tuple(dict.fromkeys(column.owner for column in (*differences, *curve))),
        nuisance_sigma=(*common.nuisance_sigma, RULES.session_thrust_sigma),
    )
    position = {(column.owner, column.key): i for i, column in enumerate(rolled.columns)}
    shared = [column for column in common.columns if (column.owner, column.key) in position]
    joint = JointSpace(
        columns=(*(_common(column, common) for column in shared), *differences),
        effects=rolled.effects,
        candidates=(),
        freed=tuple(dict.fromkeys(COMMON + column.owner for column in shared)),
        nuisance_sigma=rolled.nuisance_sigma,
        one_flight=rolled,
        index=tuple(position[column.owner, column.key] for column in (*shared, *differences)),
        after=tuple(after),
    )
    return replace(joint, candidates=tuple(name for name in joint.groups if not name.startswith(COMMON)))


def _common(column: Column, common: ParameterSpace) -> Column:
    """Return the common column of a parameter.

    A candidate moves by its typical size, and so does the shape of an unknown thrust curve. An adjustment,
    and a parameter that changes nothing by itself, such as one of the form, moves within its tolerance.
    """
    effect = common.effects.get(column.owner)
    candidate = effect is not None and not effect.adjustment and column.owner not in common.freed
    free = candidate or (column.owner, column.key) == (THRUST_CURVE, "linear")
    return replace(
        column,
        owner=COMMON + column.owner,
        tolerance=column.scale if free and column.strength else column.tolerance,
        discrepancy=0.0,
        loop_discrepancy=0.0,
        form=False,
    )
