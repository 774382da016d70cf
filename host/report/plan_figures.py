"""Pictures of plans: the path from above and the side, what happens along it, the trade between plans."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib import rc_context
from matplotlib.collections import LineCollection
from matplotlib.patches import Circle, Ellipse, Rectangle
from matplotlib.patheffects import withStroke

from host.plan.pareto import Point
from host.plan.profile import Profile
from host.plan.result import Plan
from host.report.figures import AFTER, BEFORE, FLOOR, NEUTRAL, STYLE, Figure, finish
from host.route import Route
from host.route.shapes import Box, Shape, Sphere

_COLOURS = (AFTER, BEFORE, "#c29a3a", "#6b5b95")
_FORBIDDEN = "#b5482f"
_PIECES, _SAMPLES = 2000, 2500
"""Most pieces a coloured path, and samples a line, is drawn with."""
_MANY = 40
"""More waypoints than that are small points, of which the first and the last have their numbers."""
_LEAST_SPAN_M = 0.5
_FAR = 3.0
"""A limit this many times beyond what is reached is told, not shown."""


def path(plan: Plan, route: Route, along: Profile) -> Figure:
    """The path from above and from the side with waypoints and keep-out shapes, on equal axes.

    Coloured by predicted residual, by speed where none is predicted.
    """
    by_residual = along.residual_m_s2 is not None
    shade = along.speed_m_s if along.residual_m_s2 is None else along.residual_m_s2
    what = "predicted residual, m/s$^2$" if by_residual else "speed, m/s"
    north, east, down = along.p_ned
    spans = [float(np.ptp(axis)) for axis in _with_waypoints(along, route)]
    side = 0 if spans[0] > spans[1] else 1
    with rc_context(STYLE):
        canvas, axes = plt.subplots(1, 2, figsize=(9.6, 4.6))
        panels = (
            (axes[0], (1, 0), (east, north), "from above"),
            (axes[1], (side, 2), ((north, east)[side], -down), f"from the {('east', 'south')[side]}"),
        )
        lines: Any = None
        for ax, take, xy, title in panels:
            for shape in route.keep_out:
                ax.add_patch(_outline(shape, take))
            lines = _coloured(ax, np.stack(xy, axis=1), shade)
            marks = np.array(route.waypoints_m)[:, list(take)] * np.array(
                [1.0, -1.0 if take[1] == 2 else 1.0]
            )
            size = 6.0 if len(marks) <= _MANY else 3.0
            ax.plot(*marks.T, "o", color="white", markeredgecolor=NEUTRAL, markersize=size, zorder=3)
            middle = 0.5 * (marks.min(axis=0) + marks.max(axis=0))
            ax.update_datalim([middle - 0.5 * _LEAST_SPAN_M, middle + 0.5 * _LEAST_SPAN_M])
            names = [("north", "east", "height")[axis] for axis in take]
            ax.autoscale_view()
            ax.margins(0.08)
            ax.set_aspect("equal", adjustable="datalim")
            ax.locator_params(nbins=7)
            ax.set(title=title, xlabel=f"{names[0]}, m", ylabel=f"{names[1]}, m")
        _numbered(axes[0], np.array(route.waypoints_m)[:, [1, 0]])
        canvas.colorbar(lines, ax=axes.tolist(), label=what, shrink=0.85)
    plain = what.replace("$", "")
    caption = f"The path, coloured by {plain.split(',')[0]}; points are waypoints."
    if route.keep_out:
        caption += " Red: keep-out shapes."
    return finish(canvas, caption, f"Path from above and from the side; {plain}, up to {shade.max():.2g}.")


def _with_waypoints(along: Profile, route: Route) -> np.ndarray:
    return np.concatenate([along.p_ned, np.array(route.waypoints_m).T], axis=1)


def _coloured(ax: Any, xy: np.ndarray, shade: np.ndarray) -> LineCollection:
    keep = np.unique(np.linspace(0, len(xy) - 1, min(len(xy), _PIECES + 1)).round().astype(int))
    ends = xy[keep]
    lines = LineCollection(
        list(np.stack([ends[:-1], ends[1:]], axis=1)), cmap="viridis", linewidths=2.5, capstyle="round"
    )
    lines.set_array(shade[keep][:-1])
    lines.set_clim(0.0, max(float(shade.max()), 1e-2))
    ax.add_collection(lines)
    return lines


def _numbered(ax: Any, xy: np.ndarray) -> None:
    """Numbers beside the waypoints; those at one place share a label."""
    groups: list[tuple[np.ndarray, list[str]]] = []
    near = 0.03 * max(float(np.ptp(xy, axis=0).max()), 0.1)
    for k, point in enumerate(xy):
        if len(xy) > _MANY and k not in (0, len(xy) - 1):
            continue
        for place, names in groups:
            if np.linalg.norm(place - point) < near:
                names.append(str(k))
                break
        else:
            groups.append((point, [str(k)]))
    for place, names in groups:
        told = ", ".join(names) if len(names) <= 3 else f"{names[0]}, {names[1]}, ..."
        ax.annotate(
            told,
            place,
            xytext=(5, 5),
            textcoords="offset points",
            fontsize=8,
            color=NEUTRAL,
            zorder=4,
            path_effects=[withStroke(linewidth=2.5, foreground="white")],
        )


def _outline(shape: Shape, take: tuple[int, int]) -> Any:
    """A shape's shadow in a plane of two NED axes; height is up."""
    style = {"facecolor": _FORBIDDEN, "alpha": 0.3, "edgecolor": _FORBIDDEN, "linewidth": 1.0}
    if isinstance(shape, Sphere):
        a, b = (shape.centre_m[axis] for axis in take)
        return Circle((a, -b if take[1] == 2 else b), shape.radius_m, **style)
    if isinstance(shape, Box):
        low, high = list(shape.min_m), list(shape.max_m)
    elif take[1] != 2:
        return Ellipse(
            (shape.centre_m[1], shape.centre_m[0]), 2.0 * shape.radius_m, 2.0 * shape.radius_m, **style
        )
    else:
        low = [*(c - shape.radius_m for c in shape.centre_m), shape.down_m[0]]
        high = [*(c + shape.radius_m for c in shape.centre_m), shape.down_m[1]]
    a, b = take
    bottom = -high[2] if b == 2 else low[b]
    return Rectangle((low[a], bottom), high[a] - low[a], high[b] - low[b], **style)


def over_time(plan: Plan, along: Profile) -> Figure:
    """Residual, speed, tilt, body rates, rotor thrusts, jerk over time; limits shaded, waypoints marked.

    Where the model does not predict a residual that panel is left out; samples beyond the region that its
    data covers are shaded in grey.
    """
    keep = np.unique(np.linspace(0, len(along.t_s) - 1, min(len(along.t_s), _SAMPLES)).round().astype(int))
    t_s, limits = along.t_s[keep], plan.limits
    thin = 0.8 if len(plan.waypoint_times_s) <= _MANY else 0.4
    rows = 5 + (along.residual_ned is not None)
    with rc_context(STYLE):
        canvas, axes = plt.subplots(rows, 1, figsize=(9.6, 0.9 + 1.75 * rows), sharex=True)
        rest = list(axes)
        if along.residual_ned is not None:
            ax = rest.pop(0)
            for values, name, colour in zip(
                along.residual_ned, ("north", "east", "down"), _COLOURS, strict=False
            ):
                ax.plot(t_s, values[keep], color=colour, linewidth=1.1, label=name)
            norm = np.linalg.norm(along.residual_ned, axis=0)
            ax.plot(t_s, norm[keep], color=NEUTRAL, linewidth=1.6, label="norm")
            ax.set(ylabel="residual, m/s$^2$")
            _legend(ax)
        for ax, values, bound, name, unit in (
            (rest[0], along.speed_m_s, limits.speed_max_m_s, "speed", "m/s"),
            (rest[1], along.tilt_deg, limits.tilt_max_deg, "tilt", "deg"),
            (rest[4], along.jerk_m_s3, limits.jerk_max_m_s3, "jerk", "m/s$^3$"),
        ):
            ax.plot(t_s, values[keep], color=AFTER, linewidth=1.4)
            ax.set(ylabel=f"{name}, {unit}")
            _upper(ax, float(values.max()), bound, unit)
        shares = along.rate_frd / np.array(limits.body_rate_max_rad_s)[:, None]
        for values, name, colour in zip(shares, ("roll", "pitch", "yaw"), _COLOURS, strict=False):
            rest[2].plot(t_s, values[keep], color=colour, linewidth=1.1, label=name)
        _rates(rest[2])
        for k, colour in enumerate(_COLOURS):
            rest[3].plot(
                t_s, along.thrust_share[k][keep], color=colour, linewidth=1.1, label=f"rotor {k + 1}"
            )
        _thrusts(rest[3], along, limits.thrust_headroom)
        for ax in axes:
            for at in plan.waypoint_times_s:
                ax.axvline(at, color=FLOOR, linewidth=thin, linestyle=":", zorder=0)
            if along.outside is not None:
                _spans(ax, along.t_s, along.outside)
            ax.set_xlim(0.0, float(along.t_s[-1]))
        top = axes[0].secondary_xaxis("top")
        top.set_xticks(plan.waypoint_times_s, _numbers(plan.waypoint_times_s), fontsize=7.5, color=NEUTRAL)
        top.tick_params(length=0)
        top.spines["top"].set_visible(False)
        axes[-1].set_xlabel("time, s")
        canvas.align_ylabels(axes)
    caption = "Along the reference; dotted lines with their numbers are waypoints, red is beyond a limit."
    if along.outside is not None and along.outside.any():
        caption += " Grey: beyond the region that the model's data covers."
    alt = (
        f"Over {along.t_s[-1]:.1f} s: speed up to {along.speed_m_s.max():.2f} m/s, tilt to "
        f"{along.tilt_deg.max():.0f} deg, rotor thrust {along.thrust_share.min():.2f} to "
        f"{along.thrust_share.max():.2f} of the greatest, jerk to {along.jerk_m_s3.max():.0f} m/s^3."
    )
    return finish(canvas, caption, alt)


def _numbers(times_s: Sequence[float]) -> list[str]:
    """Waypoints' numbers, without those that would stand on another."""
    told, last = [], -np.inf
    for k, at in enumerate(times_s):
        room = at - last > 0.009 * (1 + len(str(k))) * times_s[-1]
        told.append(str(k) if room else "")
        last = at if room else last
    return told


def _legend(ax: Any) -> None:
    ax.legend(ncols=1, frameon=False, fontsize=8, loc="center left", bbox_to_anchor=(1.0, 0.5))


def _upper(ax: Any, reached: float, bound: float, unit: str) -> None:
    """The range of a quantity with an upper limit, which is shaded, or told where it is far away."""
    if bound > _FAR * max(reached, 1e-9):
        ax.set_ylim(0.0, 1.12 * max(reached, 0.01 * bound))
        ax.text(1.008, 0.5, f"limit\n{bound:g} {unit}", transform=ax.transAxes, fontsize=8, color=_FORBIDDEN)
        return
    top = 1.1 * max(bound, reached)
    ax.axhspan(bound, top, color=_FORBIDDEN, alpha=0.18, linewidth=0)
    ax.set_ylim(0.0, top)
    ax.text(
        1.008,
        bound / top,
        f"{bound:g} {unit}",
        transform=ax.transAxes,
        fontsize=8,
        color=_FORBIDDEN,
        va="center",
    )


def _rates(ax: Any) -> None:
    for low, high in ((-1.15, -1.0), (1.0, 1.15)):
        ax.axhspan(low, high, color=_FORBIDDEN, alpha=0.18, linewidth=0)
    ax.set(ylim=(-1.15, 1.15), ylabel="body rate, of limit")
    _legend(ax)


def _thrusts(ax: Any, along: Profile, headroom: tuple[float, float]) -> None:
    low, high = headroom
    top = min(1.0, max(high + 0.08, 1.05 * float(along.thrust_share.max())))
    ax.axhspan(min(0.0, float(along.thrust_share.min())), low, color=_FORBIDDEN, alpha=0.18, linewidth=0)
    ax.axhspan(high, max(top, high), color=_FORBIDDEN, alpha=0.18, linewidth=0)
    ax.set_ylim(min(0.0, float(along.thrust_share.min())), top)
    ax.set_ylabel("thrust, of greatest")
    _legend(ax)


def _spans(ax: Any, t_s: np.ndarray, inside: np.ndarray) -> None:
    """Grey wherever the flag is set."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], inside, [False]]).astype(int)))
    for start, stop in zip(edges[::2], edges[1::2], strict=True):
        ax.axvspan(t_s[start], t_s[stop - 1], color=FLOOR, alpha=0.22, linewidth=0, zorder=0)


def trade(points: Sequence[Point]) -> Figure:
    """Predicted residual over jerk, a point a plan; plans with scaled weights are joined in their order."""
    known = [
        (point, point.jerk_rms_m_s3, point.residual_rms_m_s2)
        for point in points
        if point.jerk_rms_m_s3 is not None and point.residual_rms_m_s2 is not None
    ]
    with rc_context(STYLE):
        canvas, ax = plt.subplots(figsize=(7.2, 4.6))
        scaled = [(x, y) for point, x, y in known if point.factor is not None]
        if scaled:
            ax.plot(*zip(*scaled, strict=True), "o-", color=AFTER, linewidth=1.2, markersize=6.0)
        places = np.array([(x, y) for _, x, y in known])
        reach = np.ptp(places, axis=0) + 1e-9 if known else np.ones(2)
        for k, (point, x, y) in enumerate(known):
            told = point.kind if point.factor is None else f"x {point.factor:g}"
            if point.factor is None:
                ax.plot(x, y, "s", color=BEFORE, markersize=6.5)
            crowded = (np.abs((places[:k] - places[k]) / reach) < (0.12, 0.12)).all(axis=1).any()
            offset, side = ((-7, -12), "right") if crowded else ((7, 6), "left")
            ax.annotate(told, (x, y), xytext=offset, ha=side, textcoords="offset points", fontsize=9)
        ax.margins(0.16)
        ax.set(xlabel="jerk, RMS, m/s$^3$", ylabel="predicted residual, RMS, m/s$^2$")
    told = "; ".join(f"{point.label} {y:.2f} at {x:.1f}" for point, x, y in known)
    return finish(
        canvas,
        "What a smaller residual costs: numbers are factors on the weights of thrusts and their rates.",
        f"Predicted residual in m/s^2 at jerk in m/s^3: {told or 'no plan was found'}.",
    )
