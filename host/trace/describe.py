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

from trimtab.host.trace import words
from trimtab.host.trace.decision.rules import RULES
from trimtab.host.trace.fields import ClosedForm, fit_forms
from trimtab.host.trace.segments import BIN_S, Segments
from trimtab.host.vehicle import Vehicle

Channel = Literal["force", "torque"]

BLOCKS = 4
"""Contiguous parts of each flight that are left out in turn where all flew one reference."""

RUN_S = 1.2
"""Length of the pieces that are drawn again for an interval: disturbances last some tenths of a second."""

ANSWERS: dict[Channel, tuple[str, ...]] = {"force": ("thrust", "attitude"), "torque": ("thrust",)}
"""What the law turns against any disturbance: it goes with one whatever its cause, so it names none where a
cause explains as much."""

FLOORS: dict[Channel, float] = {"force": RULES.force_floor_m_s2, "torque": RULES.torque_floor_rad_s2}
"""Explained disturbance, rms, below which it needs no name."""

_CENTRES = 16
_DRAWS = 400
_RIDGES = 10.0 ** np.arange(-3.0, 3.1)
_FEWEST = 5
_CELLS = 6


@dataclass(frozen=True, kw_only=True)
class Bins:
    """The disturbance and what it may depend on, a row for each bin of 0.1 s.

    segment, flight, reference (n,) numbers; t_s (n,) since tracking began; w (n, 6) specific force m/s^2 and
    angular acceleration rad/s^2, FRD; R (n, 3, 3) R_ned_frd; p, v (n, 3) NED; rate (n, 3) FRD; rotors (n, 4)
    commanded thrust over mass, m/s^2.
    """

    segment: np.ndarray
    flight: np.ndarray
    reference: np.ndarray
    t_s: np.ndarray
    w: np.ndarray
    R: np.ndarray
    p: np.ndarray
    v: np.ndarray
    rate: np.ndarray
    rotors: np.ndarray

    @property
    def force_ned(self) -> np.ndarray:
        """Specific force (n, 3) in NED."""
        return np.einsum("nij,nj->ni", self.R, self.w[:, :3])

    @property
    def v_frd(self) -> np.ndarray:
        """Velocity (n, 3) in body axes."""
        return np.einsum("nij,ni->nj", self.R, self.v)


@dataclass(frozen=True, kw_only=True)
class Skill:
    """Held-out skill of one group, 1 - MSE / variance, and the interval that holds it with 95 %.

    `rms` is what the group explains, in the channel's unit; `counts`: that it is more than nothing, and more
    than what is worth a name.
    """

    group: str
    skill: float
    low: float
    high: float
    rms: float
    counts: bool


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
        """An entry of `slopes`."""
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
        """The skill of a group."""
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
        """The value of `description`."""

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
            "words": words.description(self),
        }


def bins_of(w: np.ndarray, data: Segments, references: Sequence[str | None], vehicle: Vehicle) -> Bins:
    """The rows of disturbances w (segments, bins, 6); `references` names that of each flight, if known."""
    count, bins, _ = w.shape
    per_bin = data.steps // bins
    middle = per_bin // 2

    def means(values: np.ndarray) -> np.ndarray:
        return values.reshape(count, bins, per_bin, -1).mean(2).reshape(count * bins, -1)

    names = [name or f"flight {index}" for index, name in enumerate(references)]
    number = {name: k for k, name in enumerate(dict.fromkeys(names))}
    seen = data.pose_weight > 0
    p, R = _filled(data.position, seen), _filled(data.attitude, seen)
    c1, c2 = vehicle.thrust_curve
    command = data.command[:, -data.steps :]
    rotors = command if data.in_newton else vehicle.thrust_max_n * command * (c1 + c2 * command)
    start = np.repeat(data.start_s, bins)
    flight = np.repeat(data.flight, bins)
    return Bins(
        segment=np.repeat(np.arange(count), bins),
        flight=flight,
        reference=np.array([number[name] for name in names])[flight],
        t_s=start + np.tile(BIN_S * (np.arange(bins) + 0.5), count),
        w=w.reshape(-1, 6),
        R=R.reshape(count, bins, per_bin, 9)[:, :, middle].reshape(-1, 3, 3),
        p=means(p),
        v=means(np.gradient(p, data.dt_s, axis=1)),
        rate=means(data.rate),
        rotors=means(rotors) / vehicle.mass_kg,
    )


def _filled(values: np.ndarray, seen: np.ndarray) -> np.ndarray:
    """Values (S, H, k) with the steps that were not seen taken from their neighbours."""
    steps = np.arange(seen.shape[1])
    out = np.empty(values.shape)
    for k, here in enumerate(seen):
        for i in range(values.shape[2]):
            out[k, :, i] = np.interp(steps, steps[here], values[k, here, i])
    return out


def describe(
    w: np.ndarray, data: Segments, references: Sequence[str | None], vehicle: Vehicle
) -> Description:
    """What disturbances w (segments, bins, 6) depend on; `references` names the reference of each flight.

    Where the measured body rate drives the attitude the last three channels are gyro errors: nothing is said
    of torque.
    """
    bins = bins_of(w, data, references, vehicle)
    folds, held_out = _folds(bins)
    steady = np.einsum("nij,njk->nik", bins.R, _constant(bins, world=True))
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
    """The closed form of most skill where the force depends on position and the form says as much."""
    if force.group != "position":
        return None
    constant = _constant(bins, world=True)
    left = _held_out(_grams(constant, bins.w[:, :3], bins), bins, folds, constant.shape[2]).sum()
    scored = [replace(form, skill=1.0 - float(errors.sum() / left)) for form, errors in forms]
    margin = RULES.form_skill_margin
    richest = max(*(form.skill for form in scored), force.skill_of("position").skill)
    most = max(RULES.clear_form_skill, richest - margin)
    return next((form for form in scored if form.skill >= most), None)


def _folds(bins: Bins) -> tuple[np.ndarray, Literal["reference", "blocks"]]:
    """Which fold each row is held out in (n,), and what a fold is."""
    if len(np.unique(bins.reference)) > 1:
        return bins.reference, "reference"
    return _blocks(bins), "blocks"


def _blocks(bins: Bins) -> np.ndarray:
    """Contiguous parts of each flight's time, whole segments, numbered alike in all flights (n,)."""
    starts = np.array([bins.t_s[bins.segment == k].min() for k in range(bins.segment.max() + 1)])
    edges = np.quantile(starts, np.arange(1, BLOCKS) / BLOCKS)
    return np.searchsorted(edges, starts, side="right")[bins.segment]


def _features(bins: Bins) -> dict[str, tuple[np.ndarray, tuple[str, ...], str, bool]]:
    """By group: basis (n, m), names of its first columns, which are linear, their units, and whether the
    axes natural to it are the world's."""
    up = bins.R[:, 2, :]
    collective = bins.rotors.sum(1)
    yaw = np.arctan2(bins.R[:, 1, 0], bins.R[:, 0, 0])
    # Differences of front and rear, left and right, and of the two diagonals, whatever the order of rotors.
    turn = bins.rotors @ np.array([[1.0, 1.0, -1.0, -1.0], [1.0, -1.0, 1.0, -1.0], [1.0, -1.0, -1.0, 1.0]]).T
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
            np.column_stack([collective, turn, _squares(np.column_stack([collective, turn]))]),
            ("collective thrust", "thrust 1+2-3-4", "thrust 1-2+3-4", "thrust 1-2-3+4"), "(m/s^2)", False,
        ),
    }  # fmt: skip


def _squares(x: np.ndarray) -> np.ndarray:
    """All products (n, m (m + 1) / 2) of two of the columns."""
    first, second = np.triu_indices(x.shape[1])
    return x[:, first] * x[:, second]


def _bumps(p: np.ndarray) -> np.ndarray:
    """Gaussian bumps (n, k) about places the farthest apart, as wide as they are apart."""
    chosen = [int(np.linalg.norm(p - p.mean(0), axis=1).argmin())]
    distance = np.full(len(p), np.inf)
    while len(chosen) < min(_CENTRES, len(p)):
        distance = np.minimum(distance, np.linalg.norm(p - p[chosen[-1]], axis=1))
        chosen.append(int(distance.argmax()))
    width = max(float(distance.max()), 0.1)
    apart = np.linalg.norm(p[:, None] - p[chosen], axis=2)
    return np.exp(-0.5 * (apart / width) ** 2)


def _dependence(
    channel: Channel, bins: Bins, folds: np.ndarray, forms: Sequence[np.ndarray] = ()
) -> Dependence:
    """Every group's skill for a channel, the group of most skill and its slopes.

    `forms` are squared errors (n,) of closed forms of position: a force of a small place that one reference
    alone went through shows in them, not in a smooth fit.
    """
    y = bins.w[:, :3] if channel == "force" else bins.w[:, 3:]
    world = channel == "force"
    constant = _constant(bins, world)
    base = _grams(constant, y, bins)
    unit = _units(bins)
    left = _held_out(base, bins, folds, constant.shape[2])
    skills = [_skill(channel, "constant", left, np.bincount(bins.segment, (y**2).sum(1)), bins, unit)]
    features = _features(bins)
    for group, (basis, _, _, natural) in features.items():
        columns = _columns(_standard(basis), bins.R if natural and world else None)
        grams = _grams(np.concatenate([constant, columns], axis=2), y, bins)
        errors = _held_out(grams, bins, folds, constant.shape[2])
        tried = [errors]
        if group == "position":
            tried += [np.bincount(bins.segment, squares) for squares in forms]
        scored = [_skill(channel, group, each, left, bins, unit) for each in tried]
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


def _constant(bins: Bins, world: bool) -> np.ndarray:
    """Columns (n, 3, k) of pushes constant in body axes and, for a force, in the world's."""
    ones = np.ones((len(bins.w), 1))
    body = _columns(ones, None)
    return np.concatenate([body, _columns(ones, bins.R)], axis=2) if world else body


def _columns(basis: np.ndarray, R: np.ndarray | None) -> np.ndarray:
    """Columns (n, 3, 3 m) in body axes of a basis (n, m) for each axis; R turns those of the world."""
    axes = np.eye(3)[None] if R is None else np.swapaxes(R, 1, 2)
    product = basis[:, None, :, None] * axes[:, :, None, :]
    return product.reshape(len(basis), 3, -1)


def _standard(basis: np.ndarray) -> np.ndarray:
    return (basis - basis.mean(0)) / np.maximum(basis.std(0), 1e-9)


def _grams(columns: np.ndarray, y: np.ndarray, bins: Bins) -> np.ndarray:
    """Grams (segments, 1 + k, 1 + k) of [y | columns]."""
    whole = np.concatenate([y[:, :, None], columns], axis=2)
    count = int(bins.segment.max()) + 1
    whole = whole.reshape(count, -1, whole.shape[2])
    return np.swapaxes(whole, 1, 2) @ whole


def _held_out(grams: np.ndarray, bins: Bins, folds: np.ndarray, free: int) -> np.ndarray:
    """Squared error (segments,) of each segment, predicted by a fit without its fold.

    The first `free` columns are not penalised; the ridge of the others is chosen by folds of the training
    data alone.
    """
    first = np.flatnonzero(np.r_[True, np.diff(bins.segment) > 0])
    outer, inner = folds[first], _blocks(bins)[first]
    errors = np.empty(len(grams))
    for fold in np.unique(outer):
        out = outer == fold
        rest = np.unique(outer[~out])
        parts = outer if len(rest) > 1 else inner
        ridge = _RIDGES[0]
        if grams.shape[1] > 1 + free:
            scores = np.zeros(len(_RIDGES))
            for part in np.unique(parts[~out]):
                check = ~out & (parts == part)
                fit, judge = grams[~out & ~check].sum(0), grams[check].sum(0)
                if fit[0, 0] == 0.0:
                    continue
                scores += [_error(judge, _ridge(fit, r, free)) for r in _RIDGES]
            ridge = _RIDGES[int(scores.argmin())]
        slope = _ridge(grams[~out].sum(0), ridge, free)
        errors[out] = [_error(gram, slope) for gram in grams[out]]
    return errors


def _ridge(gram: np.ndarray, ridge: float, free: int) -> np.ndarray:
    """Coefficients (k,) of least squares with a penalty in shares of the columns' mean square."""
    A, b = gram[1:, 1:], gram[1:, 0]
    scale = float(np.trace(A)) / len(A)
    penalty = np.full(len(A), ridge * scale)
    penalty[:free] = 1e-6 * scale
    return np.linalg.solve(A + np.diag(penalty), b)


def _error(gram: np.ndarray, slope: np.ndarray) -> float:
    return float(gram[0, 0] - 2.0 * gram[0, 1:] @ slope + slope @ gram[1:, 1:] @ slope)


def _units(bins: Bins) -> np.ndarray:
    """Which piece each segment belongs to (segments,): the same time of a reference, in all its flights."""
    first = np.flatnonzero(np.r_[True, np.diff(bins.segment) > 0])
    piece = np.floor(bins.t_s[first] / RUN_S).astype(int)
    _, unit = np.unique(np.column_stack([bins.reference[first], piece]), axis=0, return_inverse=True)
    return unit.reshape(-1)


def _skill(
    channel: Channel, group: str, errors: np.ndarray, left: np.ndarray, bins: Bins, unit: np.ndarray
) -> Skill:
    """Skill of errors over those `left` without the group, and its interval over pieces drawn again."""
    sums = np.column_stack([np.bincount(unit, errors), np.bincount(unit, left)])
    rng = np.random.default_rng(0)
    drawn = sums[rng.integers(len(sums), size=(_DRAWS, len(sums)))].sum(1)
    spread = 1.0 - drawn[:, 0] / np.maximum(drawn[:, 1], 1e-300)
    low, high = np.quantile(spread, [0.025, 0.975])
    skill = 1.0 - float(errors.sum()) / max(float(left.sum()), 1e-300)
    rms = float(np.sqrt(max(float(left.sum() - errors.sum()), 0.0) / len(bins.w)))
    return Skill(
        group=group,
        skill=skill,
        low=float(low),
        high=float(high),
        rms=rms,
        counts=bool(low > 0.0 and skill > RULES.min_skill and rms > FLOORS[channel]),
    )


def _slopes(
    channel: Channel,
    bins: Bins,
    y: np.ndarray,
    basis: np.ndarray,
    names: tuple[str, ...],
    unit: str,
    natural: bool,
) -> tuple[Slope, ...]:
    """The linear dependences that do most, each axis on each named quantity, fitted together."""
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
            unit=f"{words.UNITS[channel]} a {unit}",
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
