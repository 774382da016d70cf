"""Description of a disturbance outside the library: what it depends on, and the field of its force.

The estimated disturbance is regressed on one group of quantities at a time, by ridge regression on a small
smooth basis. The regression is trained without the reference that it is judged on. Skill is the held-out
share of the variance that a group explains beyond constant forces. A group without held-out skill explains
nothing, however well it fits.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Any, Literal

import numpy as np

from trimtab.host.trace.data.segments import Segments
from trimtab.host.trace.decision.findings import CHANNEL_UNITS
from trimtab.host.trace.decision.rules import RULES
from trimtab.host.trace.residual.closed_forms import ClosedForm, fit_forms
from trimtab.host.trace.residual.features import (
    Bins,
    bins_of,
    columns_of,
    constant_columns,
    features_of,
    standardised,
)
from trimtab.host.trace.residual.regression import (
    Channel,
    Skill,
    folds_of,
    held_out_squares,
    pieces_of,
    segment_grams,
    skill_of_group,
)
from trimtab.host.vehicle import Vehicle

RESPONSES: dict[Channel, tuple[str, ...]] = {"force": ("thrust", "attitude"), "torque": ("thrust",)}
"""Groups that the control law changes in response to any disturbance, whatever its cause. They correlate with
the disturbance, so another group that explains as much takes precedence."""

_MIN_CELL_BINS = 5
"""Bins that a cell of the force field needs."""
_CELLS = 6
"""Cells along the longest side of the force field."""


@dataclass(frozen=True, kw_only=True)
class Slope:
    """A leading linear dependence of one axis of the disturbance on one quantity.

    axis, quantity: their names. value, unit: change of the disturbance per unit of the quantity. curve:
    mean quantity and mean disturbance on that axis in each of some groups of bins, ordered by the quantity.
    """

    axis: str
    quantity: str
    value: float
    unit: str
    curve: Annotated[np.ndarray, "groups 2"]

    def to_json(self) -> dict[str, Any]:
        """Return an entry of the JSON list `slopes`."""
        return {
            "axis": self.axis,
            "quantity": self.quantity,
            "value": round(self.value, 4),
            "unit": self.unit,
        }


@dataclass(frozen=True, kw_only=True)
class Dependence:
    """What the residual force or torque depends on.

    Attributes
    ----------
    channel
        Force or torque.
    group
        Group of quantities that explains the channel best; None if no group explains it.
    skills
        Held-out skill of every group.
    slopes
        Leading linear dependences on the quantities of that group.
    mean
        Mean (3,) over all bins, FRD, m/s^2 or rad/s^2.
    """

    channel: Channel
    group: str | None
    skills: tuple[Skill, ...]
    slopes: tuple[Slope, ...]
    mean: tuple[float, float, float]

    def skill_of(self, group: str) -> Skill:
        """Return the skill of the group with this name."""
        return next(skill for skill in self.skills if skill.group == group)

    @property
    def responses(self) -> tuple[str, ...]:
        """Groups that the control law changes in response to any disturbance of this channel."""
        return RESPONSES[self.channel]

    @property
    def rivals(self) -> list[Skill]:
        """Skills of other groups that may explain as much; empty if `group` is None."""
        if self.group is None:
            return []
        best = self.skill_of(self.group)
        return [
            s
            for s in self.skills
            if s.counts and s.group not in (best.group, "constant") and s.high > best.low
        ]


@dataclass(frozen=True, kw_only=True)
class Description:
    """What the unexplained disturbance depends on.

    Attributes
    ----------
    held_out
        What a fold of the cross-validation is: a "reference", or "blocks" of time if all flights flew one
        reference.
    force, torque
        Dependence of either channel. The torque is None if the measured body rate drives the attitude.
    cells, pushes
        Mean position in m and mean specific force in m/s^2, NED, of the cells of a coarse grid that hold
        enough data.
    form
        Closed form of the force; None unless one fits clearly.
    """

    held_out: Literal["reference", "blocks"]
    force: Dependence
    torque: Dependence | None
    cells: Annotated[np.ndarray, "cells 3"]
    pushes: Annotated[np.ndarray, "cells 3"]
    form: ClosedForm | None

    def to_json(self) -> dict[str, Any]:
        """Return the JSON object `description` without its sentences."""

        def dependence(one: Dependence) -> dict[str, Any]:
            return {
                "group": one.group,
                "skills": [
                    {
                        "group": skill.group,
                        "skill": round(skill.skill, 4),
                        "low": round(skill.low, 4),
                        "high": round(skill.high, 4),
                        "rms": round(skill.rms, 4),
                    }
                    for skill in one.skills
                ],
                "slopes": [slope.to_json() for slope in one.slopes],
                "mean": [round(value, 4) for value in one.mean],
            }

        return {
            "held_out": self.held_out,
            "force": dependence(self.force),
            "torque": None if self.torque is None else dependence(self.torque),
            "field": [
                {"position_m": [round(float(x), 3) for x in p], "force_m_s2": [round(float(x), 4) for x in f]}
                for p, f in zip(self.cells, self.pushes, strict=True)
            ],
            "form": None if self.form is None else self.form.to_json(),
        }


def describe(
    w: Annotated[np.ndarray, "segments bins 6"],
    data: Segments,
    references: Sequence[str | None],
    vehicle: Vehicle,
) -> Description:
    """Return what a disturbance depends on.

    Parameters
    ----------
    w
        Disturbance, FRD: specific force in m/s^2, then angular acceleration in rad/s^2.
        If the measured body rate drives the attitude, the last three components are gyro errors and the
        description has no torque.
    data
        Segments of the disturbance.
    references
        Id of the reference of each flight; None where it is unknown.
    vehicle
        Vehicle of all flights.
    """
    bins = bins_of(w, data, references, vehicle)
    folds, held_out = folds_of(bins)
    steady = np.einsum("nij,njk->nik", bins.R, constant_columns(bins, world=True))
    forms = fit_forms(bins.p, bins.force_ned, folds, steady)
    force = _dependence("force", bins, folds, [errors for _, errors in forms])
    torque = None if data.rate_driven else _dependence("torque", bins, folds)
    cells, pushes = _grid(bins)
    return Description(
        held_out=held_out,
        force=force,
        torque=torque,
        cells=cells,
        pushes=pushes,
        form=_clear_form(bins, folds, force, forms),
    )


def _clear_form(
    bins: Bins, folds: np.ndarray, force: Dependence, forms: Sequence[tuple[ClosedForm, np.ndarray]]
) -> ClosedForm | None:
    """Return the simplest closed form that explains the force about as well as the best description.

    None if the force does not depend on position or no form has enough skill. forms: each form with its
    held-out squared errors (rows,).
    """
    if force.group != "position":
        return None
    constant = constant_columns(bins, world=True)
    grams = segment_grams(constant, bins.w[:, :3], bins)
    constant_errors = held_out_squares(grams, bins, folds, constant.shape[2]).sum()
    scored = [replace(form, skill=1.0 - float(errors.sum() / constant_errors)) for form, errors in forms]
    best = max(*(form.skill for form in scored), force.skill_of("position").skill)
    min_skill = max(RULES.clear_form_skill, best - RULES.form_skill_margin)
    return next((form for form in scored if form.skill >= min_skill), None)


def _dependence(
    channel: Channel, bins: Bins, folds: np.ndarray, forms: Sequence[np.ndarray] = ()
) -> Dependence:
    """Return the skill of every group for a channel, the group that explains it best, and its slopes.

    forms: held-out squared errors (rows,) of closed forms. They count as fits of position, since they show
    a force that acts in a small place on the path of only one reference, which a smooth fit misses.
    """
    y = bins.w[:, :3] if channel == "force" else bins.w[:, 3:]
    world = channel == "force"
    constant = constant_columns(bins, world)
    base = segment_grams(constant, y, bins)
    piece = pieces_of(bins)
    constant_errors = held_out_squares(base, bins, folds, constant.shape[2])
    power = np.bincount(bins.segment, (y**2).sum(1))
    skills = [skill_of_group(channel, "constant", constant_errors, power, bins, piece)]
    features = features_of(bins)
    for group, (basis, _, _, natural) in features.items():
        columns = columns_of(standardised(basis), bins.R if natural and world else None)
        grams = segment_grams(np.concatenate([constant, columns], axis=2), y, bins)
        errors = held_out_squares(grams, bins, folds, constant.shape[2])
        candidates = [errors]
        if group == "position":
            candidates += [np.bincount(bins.segment, squares) for squares in forms]
        scored = [skill_of_group(channel, group, each, constant_errors, bins, piece) for each in candidates]
        skills.append(max(scored, key=lambda skill: skill.skill))
    x, y_, z = (float(value) for value in y.mean(0))
    relevant = [skill for skill in skills if skill.counts]
    best = max(relevant, key=_rank(channel, relevant)).group if relevant else None
    slopes = ()
    if best in features:
        slopes = _slopes(channel, bins, y, *features[best])
    return Dependence(channel=channel, group=best, skills=tuple(skills), slopes=slopes, mean=(x, y_, z))


def _rank(channel: Channel, relevant: Sequence[Skill]) -> Callable[[Skill], tuple[bool, bool, float]]:
    """Return the sort key of groups, lowest first: constant, responses of the control law, causes.

    Within these, groups rank by skill. A response ranks as a cause if it clearly explains more than all
    causes.
    """
    causes = [skill for skill in relevant if skill.group not in ("constant", *RESPONSES[channel])]
    highest = max((skill.high for skill in causes), default=-np.inf)

    def rank(skill: Skill) -> tuple[bool, bool, float]:
        is_response = skill.group in RESPONSES[channel] and skill.low < highest
        return skill.group != "constant", not is_response, skill.skill

    return rank


def _slopes(
    channel: Channel,
    bins: Bins,
    y: np.ndarray,
    basis: np.ndarray,
    names: tuple[str, ...],
    unit: str,
    natural: bool,
) -> tuple[Slope, ...]:
    """Return the strongest linear dependences of the axes on the named quantities, fitted together.

    y (rows, 3): disturbance, FRD. basis (rows, functions): its first len(names) columns are the quantities,
    in `unit`. natural: whether the world's axes are natural to the group.
    """
    world = natural and channel == "force"
    target = bins.force_ned if world else y
    linear = basis[:, : len(names)]
    X = np.column_stack([linear - linear.mean(0), np.ones(len(y))])
    slope = np.linalg.lstsq(X, target, rcond=None)[0][:-1]
    strength = np.abs(slope) * linear.std(0)[:, None]
    axes = ("north", "east", "down") if world else ("x", "y", "z")
    slopes = [
        Slope(
            axis=axes[int(i)],
            quantity=names[int(k)],
            value=float(slope[k, i]),
            unit=f"{CHANNEL_UNITS[channel]} a {unit}",
            curve=_curve(linear[:, k], target[:, i]),
        )
        for k, i in np.argwhere(strength >= RULES.leading_share * strength.max())
    ]
    return tuple(sorted(slopes, key=lambda s: -strength[names.index(s.quantity), axes.index(s.axis)]))


def _curve(quantity: np.ndarray, value: np.ndarray) -> np.ndarray:
    """Return mean quantity and mean value (10, 2) of each tenth of the rows, ordered by the quantity."""
    order = np.argsort(quantity, kind="stable")
    return np.array([[quantity[part].mean(), value[part].mean()] for part in np.array_split(order, 10)])


def _grid(bins: Bins) -> tuple[np.ndarray, np.ndarray]:
    """Return mean position (cells, 3) and mean force (cells, 3), NED, of grid cells with enough bins."""
    span = np.ptp(bins.p, axis=0)
    size = max(float(span.max()) / _CELLS, 0.2)
    _, cell = np.unique(np.floor((bins.p - bins.p.min(0)) / size).astype(int), axis=0, return_inverse=True)
    cell = cell.reshape(-1)
    count = np.bincount(cell)
    filled = count >= _MIN_CELL_BINS

    def means(x: np.ndarray) -> np.ndarray:
        return np.column_stack([np.bincount(cell, x[:, i]) / count for i in range(3)])[filled]

    return means(bins.p), means(bins.force_ned)
