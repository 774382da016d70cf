"""Figures of flights in the paper's studies: errors as boxes, paths planned and flown."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import matplotlib.pyplot as plt
import numpy as np
from matplotlib import rc_context

from trimtab.host.report.figures import AFTER, BEFORE, STYLE, Figure, finish

_COLOURS = (BEFORE, AFTER, "#5a9bb0", "#d59a87", "#444444", "#7a6aa0")
_GROUP = 0.68
"""Width of the boxes of a group; the distance of groups is 1."""
_MANY = 100
"""Points from which on they are drawn small and pale."""


def boxes(errors_mm: Mapping[str, Mapping[str, Sequence[float]]], caption: str) -> Figure:
    """Draw errors, mm, by group and kind as boxes with all their points; also as PNG.

    Whiskers go from the 5th to the 95th percentile. At most six kinds.
    """
    rng = np.random.default_rng(0)
    kinds = list(next(iter(errors_mm.values())))
    colours = dict(zip(kinds, _COLOURS, strict=False))
    pitch = _GROUP / len(kinds)
    with rc_context(STYLE):
        canvas, ax = plt.subplots(figsize=(8.4, 3.8))
        for i, each in enumerate(errors_mm.values()):
            for k, (kind, colour) in enumerate(colours.items()):
                values, place = np.asarray(each[kind]), i + pitch * (k - 0.5 * (len(kinds) - 1))
                if not len(values):
                    continue
                shaken = place + rng.uniform(-pitch / 3.0, pitch / 3.0, len(values))
                alpha, size = (0.18, 2.5) if len(values) > _MANY else (0.7, 5.0)
                ax.plot(shaken, values, ".", color=colour, alpha=alpha, markersize=size, zorder=1)
                ax.boxplot(
                    values,
                    positions=[place],
                    widths=0.7 * pitch,
                    whis=(5.0, 95.0),
                    showfliers=False,
                    manage_ticks=False,
                    boxprops={"color": colour},
                    whiskerprops={"color": colour},
                    capprops={"color": colour},
                    medianprops={"color": colour, "linewidth": 2.0},
                )
        for kind, colour in colours.items():
            ax.plot([], [], "s", color=colour, label=kind)
        ax.set_xticks(range(len(errors_mm)), list(errors_mm))
        ax.set(ylabel="position error, mm", ylim=(0.0, None))
        ax.legend(frameon=False, ncols=len(kinds) // 2)
    medians = "; ".join(
        f"{group}: "
        + ", ".join(f"{kind} {np.median(values):.0f} mm" for kind, values in each.items() if len(values))
        for group, each in errors_mm.items()
    )
    return finish(canvas, caption, f"Box plot of position errors, medians {medians}.", png=True)


def flown_paths(
    planned_ned_m: Mapping[str, Sequence[Sequence[float]]],
    flown_ned_m: Mapping[str, Sequence[Sequence[float]] | None],
    caption: str,
) -> Figure:
    """Draw the path of each kind from above and from the side, planned and flown; also as PNG."""
    with rc_context(STYLE):
        canvas, axes = plt.subplots(
            2, len(planned_ned_m), figsize=(8.4, 5.6), squeeze=False, height_ratios=(3.0, 1.2), sharex="col"
        )
        for column, (kind, planned) in zip(axes.T, planned_ned_m.items(), strict=True):
            for points, colour, name in (
                (planned, BEFORE, "planned"),
                (flown_ned_m[kind], AFTER, "flown"),
            ):
                if points is None:
                    continue
                north, east, down = np.asarray(points).T
                column[0].plot(east, north, color=colour, linewidth=1.2, label=name)
                column[1].plot(east, -down, color=colour, linewidth=1.2)
            column[0].set(title=kind, aspect="equal", adjustable="datalim")
            column[1].set(xlabel="east, m")
        axes[0, 0].set_ylabel("north, m")
        axes[1, 0].set_ylabel("height, m")
        axes[0, 0].legend(frameon=False)
    return finish(canvas, caption, f"Paths of {' and '.join(planned_ned_m)}, planned and flown.", png=True)
