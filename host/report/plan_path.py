"""Figure of a plan's path from above and from the side, with waypoints, gates and keep-out shapes."""

from __future__ import annotations

from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib import rc_context
from matplotlib.collections import LineCollection
from matplotlib.lines import Line2D
from matplotlib.patches import Circle, Ellipse, Patch, Polygon, Rectangle
from matplotlib.patheffects import withStroke

from trimtab.host.plan.profile import Profile
from trimtab.host.report.figures import NEUTRAL, STYLE, Figure, finish
from trimtab.host.route import Gate, Route
from trimtab.host.route.shapes import Box, Shape, Sphere

FORBIDDEN = "#b5482f"
MANY = 40
"""Above this number, waypoints are small points, and only the first and the last are numbered."""
_GATE = "#111111"
_GATE_WIDTH = 1.6
_SHADOW: Any = {"facecolor": FORBIDDEN, "alpha": 0.3, "edgecolor": FORBIDDEN, "linewidth": 1.0}
_PIECES = 2000
"""Greatest number of pieces in a coloured path."""
_LEAST_SPAN_M = 0.5


def path(route: Route, along: Profile) -> Figure:
    """Draw the path from above and from the side with waypoints, gates and keep-out shapes, on equal axes.

    The colour is the predicted residual, or the speed if no residual is predicted. Shapes and gates are drawn
    as projections, so a path that crosses one may be in front of it or behind it.
    """
    by_residual = along.residual_m_s2 is not None
    shade = along.speed_m_s if along.residual_m_s2 is None else along.residual_m_s2
    quantity = "predicted residual, m/s$^2$" if by_residual else "speed, m/s"
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
            for gate in route.gates or ():
                ax.add_patch(_gate(gate, np.array(route.waypoints_m[gate.waypoint]), take))
            lines = _coloured(ax, np.stack(xy, axis=1), shade)
            marks = _projected(np.array(route.waypoints_m), take)
            size = 6.0 if len(marks) <= MANY else 3.0
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
        canvas.colorbar(lines, ax=axes.tolist(), label=quantity, shrink=0.85)
        canvas.legend(handles=_handles(route), loc="outside lower center", ncols=4, frameon=False, fontsize=9)
    plain = quantity.replace("$", "")
    caption = f"The path, coloured by {plain.split(',')[0]}."
    alt = f"Path from above and from the side; {plain}, up to {shade.max():.2g}"
    if route.gates or route.keep_out:
        caption += " Gates and shapes are drawn as projections: the path may be in front of them or behind."
        alt += f"; {len(route.gates or ())} gates, {len(route.keep_out)} keep-out shapes"
    return finish(canvas, caption, f"{alt}.")


def _handles(route: Route) -> list[Any]:
    """Return the entries of the figure's legend."""
    handles: list[Any] = [
        Line2D([], [], linestyle="", marker="o", color="white", markeredgecolor=NEUTRAL, label="waypoint")
    ]
    gates = route.gates or ()
    if any(gate.is_sphere for gate in gates):
        ring: Any = {"linestyle": "", "marker": "o", "markersize": 10, "markerfacecolor": "none"}
        handles.append(Line2D([], [], markeredgecolor=_GATE, **ring, label="gate, a sphere"))
    if not all(gate.is_sphere for gate in gates):
        handles.append(Line2D([], [], color=_GATE, linewidth=_GATE_WIDTH, label="gate, an opening"))
    if route.keep_out:
        handles.append(Patch(**_SHADOW, label="keep-out shape"))
    return handles


def _gate(gate: Gate, centre_ned: np.ndarray, take: tuple[int, int]) -> Any:
    """Return a gate's projection on a plane of two NED axes; height points up.

    An opening seen edge-on is a line.
    """
    style: Any = {"fill": False, "edgecolor": _GATE, "linewidth": _GATE_WIDTH, "zorder": 2.5}
    if gate.radius_m is not None:
        x, y = _projected(centre_ned, take)
        return Circle((x, y), gate.radius_m, **style)
    return Polygon(_projected(gate.corners_ned(centre_ned), take), joinstyle="round", **style)


def _projected(points_ned: np.ndarray, take: tuple[int, int]) -> np.ndarray:
    """Return the projection (..., 2) of points (..., 3) on a plane of two NED axes; height points up."""
    return points_ned[..., list(take)] * np.array([1.0, -1.0 if take[1] == 2 else 1.0])


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
    """Write numbers beside the waypoints. Waypoints close to each other share a label."""
    groups: list[tuple[np.ndarray, list[str]]] = []
    near = 0.03 * max(float(np.ptp(xy, axis=0).max()), 0.1)
    for k, point in enumerate(xy):
        if len(xy) > MANY and k not in (0, len(xy) - 1):
            continue
        for place, names in groups:
            if np.linalg.norm(place - point) < near:
                names.append(str(k))
                break
        else:
            groups.append((point, [str(k)]))
    for place, names in groups:
        label = ", ".join(names) if len(names) <= 3 else f"{names[0]}, {names[1]}, ..."
        ax.annotate(
            label,
            place,
            xytext=(5, 5),
            textcoords="offset points",
            fontsize=8,
            color=NEUTRAL,
            zorder=4,
            path_effects=[withStroke(linewidth=2.5, foreground="white")],
        )


def _outline(shape: Shape, take: tuple[int, int]) -> Any:
    """Return a shape's projection on a plane of two NED axes; height points up."""
    if isinstance(shape, Sphere):
        x, y = _projected(np.array(shape.centre_m), take)
        return Circle((x, y), shape.radius_m, **_SHADOW)
    if isinstance(shape, Box):
        low, high = list(shape.min_m), list(shape.max_m)
    elif take[1] != 2:
        return Ellipse(
            (shape.centre_m[1], shape.centre_m[0]), 2.0 * shape.radius_m, 2.0 * shape.radius_m, **_SHADOW
        )
    else:
        low = [*(c - shape.radius_m for c in shape.centre_m), shape.down_m[0]]
        high = [*(c + shape.radius_m for c in shape.centre_m), shape.down_m[1]]
    a, b = take
    bottom = -high[2] if b == 2 else low[b]
    return Rectangle((low[a], bottom), high[a] - low[a], high[b] - low[b], **_SHADOW)
