"""What a disturbance outside the library depends on: regressions with held-out skill, and the field itself.

The estimated disturbance is regressed on one group of quantities at a time, by ridge on a small smooth basis,
trained without the reference it is judged on. Skill is what a group explains beyond constant pushes, of the
variance they leave. A group that has none explains nothing, however well it fits.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

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

ANSWERS: dict[Channel, tuple[str, ...]] = {"force": ("thrust", "attitude"), "torque": ("thrust",)}
"""What the law turns against any disturbance: it goes with one whatever its cause, so it names none where a
cause explains as much."""

_FEWEST = 5
_CELLS = 6


@dataclass(frozen=True, kw_only=True)
class Slope:
    """A leading linear dependence: change of one axis by a unit of a quantity.

    curve (k, 2): mean quantity and mean disturbance on that axis, from low to high.
    """

    axis: str
    quantity: str
    value: float
    unit: str
    curve: np.ndarray

    def to_json(self) -> dict[str, Any]:
        """Return an entry of `slopes`."""
        return {
            "axis": self.axis,
            "quantity": self.quantity,
            "value": round(self.value, 4),
            "unit": self.unit,
        }


@dataclass(frozen=True, kw_only=True)
class Dependence:
    """What one channel depends on: the group that carries it, None for none of them, every group's skill."""

    channel: Channel
    group: str | None
    skills: tuple[Skill, ...]
    slopes: tuple[Slope, ...]
    mean: tuple[float, float, float]
    """Over all bins, body axes."""

    def skill_of(self, group: str) -> Skill:
        """Return the skill of a group."""
        return next(skill for skill in self.skills if skill.group == group)

    @property
    def answers(self) -> tuple[str, ...]:
        """Return the groups with which the law answers any disturbance of this channel."""
        return ANSWERS[self.channel]

    @property
    def rivals(self) -> list[Skill]:
        """Return the skills of the other groups that may explain as much; empty where no group does."""
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
    """What the residual disturbance depends on.

    held_out: "reference", or "blocks" of time where all flights flew one. cells (k, 3) NED and pushes (k, 3)
    mean specific force there, NED, of a coarse grid where there is data; `form` a closed description where
    one fits clearly.
    """

    held_out: Literal["reference", "blocks"]
    force: Dependence
    torque: Dependence | None
    cells: np.ndarray
    pushes: np.ndarray
    form: ClosedForm | None

    def to_json(self) -> dict[str, Any]:
        """Return the value of `description`."""

        def told(one: Dependence) -> dict[str, Any]:
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
            "force": told(self.force),
            "torque": None if self.torque is None else told(self.torque),
            "field": [
                {"position_m": [round(float(x), 3) for x in p], "force_m_s2": [round(float(x), 4) for x in f]}
                for p, f in zip(self.cells, self.pushes, strict=True)
            ],
            "form": None if self.form is None else self.form.to_json(),
        }


def describe(
    w: np.ndarray, data: Segments, references: Sequence[str | None], vehicle: Vehicle
) -> Description:
    """Return what disturbances w (segments, bins, 6) depend on; `references` names the reference of each
    flight.

    Where the measured body rate drives the attitude the last three channels are gyro errors: nothing is said
    of torque.
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
    """Return the closed form of most skill where the force depends on position and the form says as much."""
    if force.group != "position":
        return None
    constant = constant_columns(bins, world=True)
    left = held_out_squares(
        segment_grams(constant, bins.w[:, :3], bins), bins, folds, constant.shape[2]
    ).sum()
    scored = [replace(form, skill=1.0 - float(errors.sum() / left)) for form, errors in forms]
    margin = RULES.form_skill_margin
    richest = max(*(form.skill for form in scored), force.skill_of("position").skill)
    most = max(RULES.clear_form_skill, richest - margin)
    return next((form for form in scored if form.skill >= most), None)


def _dependence(
    channel: Channel, bins: Bins, folds: np.ndarray, forms: Sequence[np.ndarray] = ()
) -> Dependence:
    """Every group's skill for a channel, the group of most skill and its slopes.

    `forms` are squared errors (n,) of closed forms of position: a force of a small place that one reference
    alone went through shows in them, not in a smooth fit.
    """
    y = bins.w[:, :3] if channel == "force" else bins.w[:, 3:]
    world = channel == "force"
    constant = constant_columns(bins, world)
    base = segment_grams(constant, y, bins)
    unit = pieces_of(bins)
    left = held_out_squares(base, bins, folds, constant.shape[2])
    skills = [skill_of_group(channel, "constant", left, np.bincount(bins.segment, (y**2).sum(1)), bins, unit)]
    features = features_of(bins)
    for group, (basis, _, _, natural) in features.items():
        columns = columns_of(standardised(basis), bins.R if natural and world else None)
        grams = segment_grams(np.concatenate([constant, columns], axis=2), y, bins)
        errors = held_out_squares(grams, bins, folds, constant.shape[2])
        tried = [errors]
        if group == "position":
            tried += [np.bincount(bins.segment, squares) for squares in forms]
        scored = [skill_of_group(channel, group, each, left, bins, unit) for each in tried]
        skills.append(max(scored, key=lambda skill: skill.skill))
    x, y_, z = (float(value) for value in y.mean(0))
    good = [skill for skill in skills if skill.counts]
    best = max(good, key=_rank(channel, good)).group if good else None
    slopes = ()
    if best in features:
        slopes = _slopes(channel, bins, y, *features[best])
    return Dependence(channel=channel, group=best, skills=tuple(skills), slopes=slopes, mean=(x, y_, z))


def _rank(channel: Channel, good: Sequence[Skill]) -> Callable[[Skill], tuple[bool, bool, float]]:
    """Order of the groups: what varies before a constant, causes before what only answers as well."""
    causes = [skill for skill in good if skill.group not in ("constant", *ANSWERS[channel])]
    most = max((skill.high for skill in causes), default=-np.inf)

    def rank(skill: Skill) -> tuple[bool, bool, float]:
        answers = skill.group in ANSWERS[channel] and skill.low < most
        return skill.group != "constant", not answers, skill.skill

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
    """Return the linear dependences that do most, each axis on each named quantity, fitted together."""
    world = natural and channel == "force"
    target = bins.force_ned if world else y
    linear = basis[:, : len(names)]
    X = np.column_stack([linear - linear.mean(0), np.ones(len(y))])
    slope = np.linalg.lstsq(X, target, rcond=None)[0][:-1]
    does = np.abs(slope) * linear.std(0)[:, None]
    axes = ("north", "east", "down") if world else ("x", "y", "z")
    found = [
        Slope(
            axis=axes[int(i)],
            quantity=names[int(k)],
            value=float(slope[k, i]),
            unit=f"{CHANNEL_UNITS[channel]} a {unit}",
            curve=_curve(linear[:, k], target[:, i]),
        )
        for k, i in np.argwhere(does >= RULES.leading_share * does.max())
    ]
    return tuple(sorted(found, key=lambda s: -does[names.index(s.quantity), axes.index(s.axis)]))


def _curve(quantity: np.ndarray, value: np.ndarray) -> np.ndarray:
    """Mean quantity and value (k, 2) of tenths of the rows, in the quantity's order."""
    order = np.argsort(quantity, kind="stable")
    return np.array([[quantity[part].mean(), value[part].mean()] for part in np.array_split(order, 10)])


def _grid(bins: Bins) -> tuple[np.ndarray, np.ndarray]:
    """Mean place (k, 3) and mean force (k, 3), NED, in the cells of a coarse grid that hold enough bins."""
    span = np.ptp(bins.p, axis=0)
    size = max(float(span.max()) / _CELLS, 0.2)
    _, cell = np.unique(np.floor((bins.p - bins.p.min(0)) / size).astype(int), axis=0, return_inverse=True)
    cell = cell.reshape(-1)
    count = np.bincount(cell)
    keep = count >= _FEWEST

    def means(x: np.ndarray) -> np.ndarray:
        return np.column_stack([np.bincount(cell, x[:, i]) / count for i in range(3)])[keep]

    return means(bins.p), means(bins.force_ned)
