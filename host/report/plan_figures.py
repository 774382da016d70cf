"""Figure of a plan over time: residual, sensitivity and distances to the limits, with its nodes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib import rc_context
from matplotlib.ticker import NullFormatter
from numpy.typing import ArrayLike

from trimtab.host.plan.box import KEEP_OUT
from trimtab.host.plan.profile import Profile
from trimtab.host.plan.result import Plan
from trimtab.host.plan.sensitivity import Sensitivity
from trimtab.host.report.figures import AFTER, BEFORE, FLOOR, NEUTRAL, STYLE, Figure, finish
from trimtab.host.route import Route

FORBIDDEN = "#b5482f"
MANY = 40
"""Above this number of waypoints, their lines are thin."""
_COLOURS = (AFTER, BEFORE, "#c29a3a", "#6b5b95")
_MARGIN_COLOURS = (*_COLOURS, "#6a9a5b")
_SAMPLES = 2500
"""Greatest number of samples in a line."""
_NODES = 300
"""Greatest number of nodes that are drawn as points."""
_NODE_STEPS = tuple(factor * 10**power for power in range(6) for factor in (1, 2, 5))
_LEAST_SHOWN_M = 1e-3


def per_node(
    plan: Plan, route: Route, along: Profile, off: Sensitivity | None, inside_gates: ArrayLike
) -> Figure:
    """Draw the residual, its sensitivity and the distance to every limit over time, with nodes as points.

    `off` is None if no model predicts a residual; its two panels are then left out. `inside_gates` holds a
    distance in m for each of the route's gates.
    """
    keep, nodes = _kept(along), np.flatnonzero(np.diff(along.node, prepend=-1))
    few = len(nodes) <= _NODES
    dots: Any = {"linestyle": "", "marker": "." if few else "", "markersize": 4.0}
    rows = 2 if off is None else 4
    facts = []
    with rc_context(STYLE):
        canvas, axes = plt.subplots(rows, 1, figsize=(9.6, 1.3 + 1.9 * rows), sharex=True)
        remaining = list(axes)
        if off is not None and along.residual is not None:
            norm = _residual(remaining[0], along, keep)
            remaining.pop(0).plot(along.t_s[nodes], norm[nodes], color=NEUTRAL, **dots)
            _sensitivities(remaining.pop(0), off, dots)
            facts.append(f"residual up to {norm.max():.2f} m/s^2")
            if (peaks := off.peaks()) is not None:
                v, a = peaks
                facts.append(f"its change up to {v.value:.2f} per m/s and {a.value:.2f} per rad")
        smallest = _shares(remaining[0], plan, along, keep)
        remaining[0].plot(along.t_s[nodes], smallest[nodes], color=NEUTRAL, **dots)
        passed_s = [plan.waypoint_times_s[gate.waypoint] for gate in route.gates or ()]
        if passed_s:
            near = np.maximum(inside_gates, _LEAST_SHOWN_M)
            remaining[1].plot(
                passed_s, near, "D", color="black", markersize=4.0, label="edges of gates", zorder=3
            )
        _distances(remaining[1], along.margins(plan.limits, route.keep_out), along.t_s, keep)
        _marked(axes, plan, along)
        canvas.align_ylabels(axes)
    facts.append(f"least margin {100.0 * smallest.min():.1f} % of its limit")
    caption = "Points are nodes, numbered below the time axis. " if few else "Along the nodes. "
    if off is not None:
        caption += (
            "Sensitivity: greatest change of the residual per m/s or rad off the reference "
            "(greatest singular value of its Jacobian, at constant rotor thrusts). "
        )
    caption += "Margins: distance to each limit as a share of the limit; for thrust, of half its range."
    caption += _grey(along)
    return finish(canvas, caption, f"Over {along.t_s[-1]:.1f} s: {', '.join(facts)}.")


def _grey(along: Profile) -> str:
    """Return the explanation of grey areas, or an empty string if there are none."""
    if along.outside is None or not along.outside.any():
        return ""
    return " Grey: outside the model's trained region."


def _kept(along: Profile) -> np.ndarray:
    """Return the indices of the samples that are drawn."""
    return np.unique(np.linspace(0, len(along.t_s) - 1, min(len(along.t_s), _SAMPLES)).round().astype(int))


def _residual(ax: Any, along: Profile, keep: np.ndarray) -> np.ndarray:
    """Draw components and norm of the predicted residual. Return the norm at all samples."""
    norm = along.residual_m_s2
    assert along.residual is not None
    assert norm is not None
    names = ("north", "east", "down", "roll torque", "pitch torque", "yaw torque")
    for row, (values, name) in enumerate(zip(along.residual, names, strict=False)):
        colour, dash = _COLOURS[row % 3], "-" if row < 3 else ":"
        ax.plot(along.t_s[keep], values[keep], dash, color=colour, linewidth=1.1, label=name)
    ax.plot(along.t_s[keep], norm[keep], color=NEUTRAL, linewidth=1.6, label="norm")
    ax.set(ylabel="residual, m/s$^2$")
    _legend(ax)
    return norm


def _sensitivities(ax: Any, off: Sensitivity, dots: Any) -> None:
    for values, name, colour in (
        (off.velocity, "to velocity,\nm/s$^2$ per m/s", AFTER),
        (off.attitude, "to attitude,\nm/s$^2$ per rad", BEFORE),
    ):
        ax.plot(off.t_s, values, color=colour, linewidth=1.3, label=name)
        ax.plot(off.t_s, values, color=colour, **dots)
    ax.set_ylim(bottom=0.0)
    ax.set(ylabel="sensitivity")
    _legend(ax)


def _shares(ax: Any, plan: Plan, along: Profile, keep: np.ndarray) -> np.ndarray:
    """Draw margins as shares of their limits, and the smallest. Return the smallest at all samples."""
    shares = along.margin_shares(plan.limits)
    smallest = np.min(list(shares.values()), axis=0)
    for (name, values), colour in zip(shares.items(), _MARGIN_COLOURS, strict=True):
        ax.plot(along.t_s[keep], values[keep], color=colour, linewidth=1.1, label=name)
    ax.plot(along.t_s[keep], smallest[keep], color=NEUTRAL, linewidth=1.6, label="least")
    ax.axhspan(-0.08, 0.0, color=FORBIDDEN, alpha=0.18, linewidth=0)
    ax.set(ylim=(-0.08, 1.04), ylabel="margin, of limit")
    _legend(ax)
    return smallest


def _distances(ax: Any, distances: Mapping[str, np.ndarray], t_s: np.ndarray, keep: np.ndarray) -> None:
    """Draw distances in m on a logarithmic axis, because a geofence is much farther than a keep-out shape."""
    for name, title, colour in (
        ("geofence_m", "geofence", AFTER),
        ("floor_m", "floor", _COLOURS[2]),
        (KEEP_OUT, "keep-out shapes", FORBIDDEN),
    ):
        if name in distances:
            shown = np.maximum(distances[name][keep], _LEAST_SHOWN_M)
            ax.plot(t_s[keep], shown, color=colour, linewidth=1.3, label=title)
    ax.set_yscale("log")
    ax.yaxis.set_major_formatter("{x:g}")
    low, high = np.log10(ax.get_ylim())
    ax.set_ylim(10.0 ** np.floor(low), 10.0 ** np.ceil(high))
    ax.yaxis.set_minor_formatter(NullFormatter())
    ax.set(ylabel="distance, m")
    _legend(ax)


def _marked(axes: Sequence[Any], plan: Plan, along: Profile) -> None:
    """Mark waypoints and samples outside the trained region; label waypoints above, time and nodes below."""
    thin = 0.8 if len(plan.waypoint_times_s) <= MANY else 0.4
    for ax in axes:
        for at in plan.waypoint_times_s:
            ax.axvline(at, color=FLOOR, linewidth=thin, linestyle=":", zorder=0)
        if along.outside is not None:
            _spans(ax, along.t_s, along.outside)
        ax.set_xlim(0.0, float(along.t_s[-1]))
    top = axes[0].secondary_xaxis("top")
    top.set_xticks(plan.waypoint_times_s, _numbers(plan.waypoint_times_s), fontsize=7.5, color=NEUTRAL)
    top.set_xlabel("waypoint", fontsize=8, color=NEUTRAL)
    top.tick_params(length=0)
    top.spines["top"].set_visible(False)
    axes[-1].set_xlabel("time, s", labelpad=1.0)
    nodes_s = [node.t_us * 1e-6 for node in plan.reference.nodes]
    step = next(step for step in _NODE_STEPS if len(nodes_s) <= 12 * step)
    below = axes[-1].secondary_xaxis(-0.36)
    below.set_xticks(nodes_s[::step], [str(k) for k in range(0, len(nodes_s), step)])
    below.tick_params(labelsize=7.5, labelcolor=NEUTRAL, color=FLOOR)
    below.spines["bottom"].set_color(FLOOR)
    below.set_xlabel("node", fontsize=8, color=NEUTRAL, labelpad=1.0)


def _numbers(times_s: Sequence[float]) -> list[str]:
    """Return labels of the waypoints, empty where they would overlap."""
    labels, last = [], -np.inf
    for k, at in enumerate(times_s):
        room = at - last > 0.009 * (1 + len(str(k))) * times_s[-1]
        labels.append(str(k) if room else "")
        last = at if room else last
    return labels


def _legend(ax: Any) -> None:
    ax.legend(ncols=1, frameon=False, fontsize=8, loc="center left", bbox_to_anchor=(1.0, 0.5))


def _spans(ax: Any, t_s: np.ndarray, inside: np.ndarray) -> None:
    """Shade the times at which the flag is set."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], inside, [False]]).astype(int)))
    for start, stop in zip(edges[::2], edges[1::2], strict=True):
        ax.axvspan(t_s[start], t_s[stop - 1], color=FLOOR, alpha=0.22, linewidth=0, zorder=0)
