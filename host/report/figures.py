"""Figures of the reports as SVG text. The same data gives the same bytes."""

from __future__ import annotations

import base64
import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import matplotlib

from trimtab.host.base.text import escaped
from trimtab.host.trace.decision.findings import CHANNEL_UNITS

matplotlib.use("svg")

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.figure import Figure as Canvas

from trimtab.host.trace import words
from trimtab.host.trace.residual.description import Dependence, Description

BEFORE, AFTER, FLOOR, NEUTRAL = "#b5482f", "#1f6f8b", "#8a8a8a", "#444444"
STYLE: Any = {
    "svg.hashsalt": "trimtab",
    "svg.fonttype": "path",
    "font.size": 9,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.alpha": 0.25,
    "figure.constrained_layout.use": True,
}


@dataclass(frozen=True, kw_only=True)
class Figure:
    """A picture with its caption, its alternative text and its size in CSS pixels."""

    svg: str
    caption: str
    alt: str
    width: int
    height: int
    png: bytes = b""
    """The same picture as PNG, if requested."""

    @property
    def source(self) -> str:
        """The picture as a data URL for an img element."""
        return "data:image/svg+xml;base64," + base64.b64encode(self.svg.encode()).decode()


def finish(canvas: Canvas, caption: str, alt: str, *, png: bool = False) -> Figure:
    """Return the canvas as a figure with its caption and alternative text."""
    width, height = (round(96 * inches) for inches in canvas.get_size_inches())
    stream, pixels = io.StringIO(), io.BytesIO()
    with matplotlib.rc_context(STYLE):
        canvas.savefig(stream, format="svg", metadata={"Date": None, "Creator": None})
        if png:
            canvas.savefig(pixels, format="png", dpi=120, metadata={"Software": None})
    plt.close(canvas)
    return Figure(
        svg=escaped(stream.getvalue(), lines=True),
        caption=caption,
        alt=alt,
        width=width,
        height=height,
        png=pixels.getvalue(),
    )


def ranking(evidence: Mapping[str, float], kept: Sequence[str]) -> Figure:
    """Draw the log evidence, nats, that is lost without each selected effect or gained with another one."""
    names = sorted(evidence, key=lambda name: evidence[name])
    with matplotlib.rc_context(STYLE):
        canvas, ax = plt.subplots(figsize=(8.4, 0.8 + 0.28 * len(names)))
        values = np.array([evidence[name] for name in names])
        shown = np.sign(values) * np.log10(1.0 + np.abs(values))
        ax.barh(names, shown, color=[AFTER if name in kept else FLOOR for name in names])
        ticks = np.array([-100, -10, 0, 10, 100, 1000, 10000])
        places = np.sign(ticks) * np.log10(1.0 + np.abs(ticks))
        inside = (places >= shown.min() - 1.0) & (places <= shown.max() + 1.0)
        ax.set_xticks(places[inside], [f"{t}" for t in ticks[inside]])
        ax.axvline(0.0, color=NEUTRAL, linewidth=0.8)
        ax.set_xlabel("log evidence for the effect, nats (named effects in blue)")
    best = ", ".join(f"{n} {evidence[n]:.0f}" for n in reversed(names[-3:]))
    return finish(
        canvas,
        "Ranking of the candidates: log evidence that is lost without a named effect, "
        "or would be gained with another one.",
        f"Candidates by log evidence in nats; the first three: {best}.",
    )


def counts(table: Mapping[str, Mapping[str, int]], caption: str, *, rows: str, columns: str) -> Figure:
    """Draw a table of counts by row and column name, each cell shaded by its share of the row; also as PNG.

    Columns that share names with rows come first, in the order of the rows.
    """
    labels = {column for row in table.values() for column in row}
    names = [name for name in table if name in labels] + sorted(labels - set(table))
    values = np.array([[row.get(name, 0) for name in names] for row in table.values()])
    with matplotlib.rc_context({**STYLE, "axes.grid": False}):
        canvas, ax = plt.subplots(figsize=(3.2 + 0.42 * len(names), 2.4 + 0.3 * len(table)))
        ax.imshow(values / values.sum(1, keepdims=True), cmap="Blues", vmin=0.0, vmax=1.0, aspect="auto")
        for (i, k), count in np.ndenumerate(values):
            if count:
                dark = count > 0.6 * values[i].sum()
                ax.text(k, i, str(count), ha="center", va="center", color="white" if dark else NEUTRAL)
        ax.set_xticks(range(len(names)), names, rotation=60, ha="right", rotation_mode="anchor")
        ax.set_yticks(range(len(table)), list(table))
        ax.set(xlabel=columns, ylabel=rows)
    right = sum(table[name].get(name, 0) for name in table)
    alt = f"{values.sum()} counts in {len(table)} rows and {len(names)} columns, {right} where names agree."
    return finish(canvas, caption, alt, png=True)


def deviations(
    families: Mapping[str, Sequence[float]], coverage: Mapping[str, tuple[float, float, float]], caption: str
) -> Figure:
    """Draw errors in standard deviations by family, and the share within two with its interval; also as PNG.

    `families` holds errors (n,); `coverage` holds the share and its lower and upper bound.
    """
    names = list(families)
    with matplotlib.rc_context(STYLE):
        canvas, (left, right) = plt.subplots(1, 2, figsize=(8.4, 0.9 + 0.55 * len(names)), sharey=True)
        for i, name in enumerate(names):
            errors = np.clip(np.asarray(families[name], dtype=float), -6.0, 6.0)
            spread = 0.28 * np.linspace(-1.0, 1.0, len(errors))
            left.scatter(errors, i + spread, s=9, color=AFTER, alpha=0.6, linewidths=0)
            if name in coverage:
                share, low, high = (100.0 * number for number in coverage[name])
                bar = np.array([[share - low], [high - share]])
                right.errorbar([share], [i], xerr=np.maximum(bar, 0.0), fmt="o", color=AFTER, capsize=3)
        left.axvspan(-2.0, 2.0, color=FLOOR, alpha=0.15, linewidth=0)
        left.set(xlim=(-6.3, 6.3), xlabel="error, reported standard deviations (beyond 6 at the edge)")
        left.set_yticks(range(len(names)), [f"{name} ({len(families[name])})" for name in names])
        left.set_ylim(-0.6, len(names) - 0.4)
        right.axvspan(90.0, 98.0, color=FLOOR, alpha=0.15, linewidth=0)
        right.set(xlim=(0.0, 101.0), xlabel="within two, % (95 % interval; target shaded)")
    shares = ", ".join(f"{name} {100 * share:.0f} %" for name, (share, _, _) in coverage.items())
    return finish(
        canvas, caption, f"Errors in standard deviations by family; within two: {shares}.", png=True
    )


def dependence(description: Description) -> Figure:
    """Draw the held-out skill of every group for force and torque, and the dependence on the best group.

    A force that depends on position is drawn as arrows from above and from the side, any other dependence as
    its leading slopes.
    """
    channels = [one for one in (description.force, description.torque) if one is not None]
    with matplotlib.rc_context(STYLE):
        canvas, axes = plt.subplots(
            len(channels), 3, figsize=(9.6, 3.2 * len(channels)), squeeze=False, width_ratios=(1.1, 1.0, 1.0)
        )
        for row, one in zip(axes, channels, strict=True):
            _skills(row[0], one)
            if one.channel == "force" and one.group == "position":
                _field(row[1], description, "east", "north", (1, 0))
                _field(row[2], description, "north", "height", (0, 2))
            else:
                _curves(row[1:], one)
    return finish(
        canvas,
        "Dependence of the disturbance outside the library: held-out skill of each group of quantities "
        "(bars: 95 % interval), and the disturbance over the best group.",
        " ".join(words.description(description)),
    )


def _skills(ax: Any, one: Dependence) -> None:
    shown = list(reversed(one.skills))
    for k, skill in enumerate(shown):
        colour = AFTER if skill.group == one.group else FLOOR
        low, high = (float(np.clip(x, -0.25, 1.0)) for x in (skill.low, skill.high))
        ax.plot([low, high], [k, k], color=colour, linewidth=5.0, alpha=0.5, solid_capstyle="butt")
        ax.plot(np.clip(skill.skill, -0.25, 1.0), k, "o", color=colour, markersize=4.5)
    ax.set_yticks(range(len(shown)), [skill.group for skill in shown])
    ax.axvline(0.0, color=NEUTRAL, linewidth=0.8)
    ax.set(xlim=(-0.27, 1.02), xlabel="held-out skill", title=one.channel)


def _field(ax: Any, description: Description, across: str, up: str, take: tuple[int, int]) -> None:
    """Draw arrows of the mean force in a plane; height points up."""
    sign = np.array([1.0, -1.0 if up == "height" else 1.0])
    place, force = description.cells[:, take] * sign, description.pushes[:, take] * sign
    longest = max(float(np.linalg.norm(description.pushes, axis=1).max()), 1e-9)
    span = max(float(np.ptp(description.cells, axis=0).max()), 0.1)
    arrows = ax.quiver(
        *place.T,
        *force.T,
        color=AFTER,
        angles="xy",
        scale_units="xy",
        scale=4.0 * longest / span,
        width=0.008,
    )
    size = float(f"{0.5 * longest:.1g}")
    ax.quiverkey(arrows, 0.66, 1.04, size, f"{size:g} m/s$^2$", labelpos="E", coordinates="axes")
    ends = np.concatenate([place, place + force * span / (4.0 * longest)])
    ax.update_datalim(ends)
    form = description.form
    if form is not None and form.name in ("point", "place"):
        keys = ("north_m", "east_m", "down_m")
        centre = np.array([form.parameters[key] for key in keys])[list(take)] * sign
        ax.plot(*centre, "x", color=BEFORE, markersize=9, markeredgewidth=2)
    ax.autoscale_view()
    ax.set_aspect("equal", adjustable="datalim")
    ax.set(xlabel=f"{across}, m", ylabel=f"{up}, m")


def _curves(row: Any, one: Dependence) -> None:
    """Draw the two leading slopes, or a text if there is none."""
    unit = CHANNEL_UNITS[one.channel].replace("^2", "$^2$")
    for k, ax in enumerate(row):
        if k >= len(one.slopes):
            ax.axis("off")
            if k == 0:
                x, y, z = one.mean
                steady = f"constant: ({x:.2g}, {y:.2g}, {z:.2g}) {unit}"
                ax.text(0.0, 0.5, "no group explains it" if one.group is None else steady)
            continue
        slope = one.slopes[k]
        ax.plot(*slope.curve.T, "o-", color=AFTER, markersize=4.0, linewidth=1.0)
        ax.locator_params(nbins=5)
        ax.set(xlabel=slope.quantity, ylabel=f"{one.channel} {slope.axis}, {unit}")
