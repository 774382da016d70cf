"""Figure that compares plans: residual, and error if they were flown, over jerk and lambda_r."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib import rc_context

from trimtab.host.plan.pareto import Point
from trimtab.host.report.figures import AFTER, BEFORE, STYLE, Figure, finish

_MARGIN = 0.16
_Value = Callable[[Point], float | None]


def trade(points: Sequence[Point]) -> Figure:
    """Draw the residual, and the mean error of flights if there are any, over jerk and over lambda_r.

    Plans with scaled weights are connected in their order. Horizontal lines are the kinds without lambda_r.
    """
    rows: list[tuple[str, _Value]] = [
        ("predicted residual, RMS, m/s$^2$", lambda point: point.residual_rms_m_s2)
    ]
    if any(point.error_mean_m is not None for point in points):
        rows.append(("flown error, mean, mm", _error_mm))
    with rc_context(STYLE):
        canvas, axes = plt.subplots(
            len(rows), 2, figsize=(9.6, 0.6 + 3.6 * len(rows)), sharex="col", sharey="row", squeeze=False
        )
        for (over_jerk, over_lambda), (title, value) in zip(axes, rows, strict=True):
            _over_jerk(over_jerk, points, value)
            _over_lambda(over_lambda, points, value)
            over_jerk.set_ylabel(title)
        axes[-1][0].set_xlabel("jerk, RMS, m/s$^3$")
        axes[-1][1].set_xlabel(r"$\lambda_r$, m$^2$/s$^4$ per N$^2$")
    listed = "; ".join(f"{point.label} {y:.2f} at {x:.1f}" for point, x, y in _known(points, rows[0][1]))
    alt = f"Predicted residual in m/s^2 at jerk in m/s^3: {listed or 'no plan was found'}."
    if len(rows) > 1:
        flown = "; ".join(f"{point.label} {y:.1f}" for point, _, y in _known(points, _error_mm))
        alt += f" Mean error of the flights in mm: {flown}."
    caption = (
        "Cost of a smaller residual. Numbers are factors on the weights of thrusts and thrust rates; "
        "lambda_r is the paper's symbol for the weight of thrusts. Dashed: the kinds without lambda_r."
    )
    return finish(canvas, caption, alt)


def _error_mm(point: Point) -> float | None:
    return None if point.error_mean_m is None else 1e3 * point.error_mean_m


def _known(points: Sequence[Point], value: _Value) -> list[tuple[Point, float, float]]:
    """Return the points that have a value, each with its jerk and the value."""
    return [
        (point, point.jerk_rms_m_s3, y)
        for point in points
        if point.jerk_rms_m_s3 is not None and (y := value(point)) is not None
    ]


def _over_jerk(ax: Any, points: Sequence[Point], value: _Value) -> None:
    known = _known(points, value)
    scaled = [(x, y) for point, x, y in known if point.factor is not None]
    if scaled:
        ax.plot(*zip(*scaled, strict=True), "o-", color=AFTER, linewidth=1.2, markersize=6.0)
    places = np.array([(x, y) for _, x, y in known])
    reach = np.ptp(places, axis=0) + 1e-9 if known else np.ones(2)
    for k, (point, x, y) in enumerate(known):
        label = point.kind if point.factor is None else f"x {point.factor:g}"
        if point.factor is None:
            ax.plot(x, y, "s", color=BEFORE, markersize=6.5)
        crowded = (np.abs((places[:k] - places[k]) / reach) < (0.2, 0.12)).all(axis=1).any()
        offset = (7, -13) if crowded else (7, 6)
        ax.annotate(label, (x, y), xytext=offset, textcoords="offset points", fontsize=9)
    ax.margins(_MARGIN)


def _over_lambda(ax: Any, points: Sequence[Point], value: _Value) -> None:
    known = [(point.lambda_r, y) for point in points if (y := value(point)) is not None]
    scaled = [(x, y) for x, y in known if x is not None]
    if scaled:
        ax.plot(*zip(*scaled, strict=True), "o-", color=AFTER, linewidth=1.2, markersize=6.0)
        ax.set_xscale("log")
    ax.margins(_MARGIN)
    for point in points:
        y = value(point)
        if y is None or point.factor is not None:
            continue
        ax.axhline(y, color=BEFORE, linewidth=1.0, linestyle="--")
        ax.annotate(
            point.kind,
            (0.98, y),
            xycoords=("axes fraction", "data"),
            xytext=(0, 3),
            textcoords="offset points",
            ha="right",
            fontsize=9,
        )
