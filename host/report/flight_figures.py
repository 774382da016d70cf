"""Figures of the study of section VI: errors of flights as boxes, paths planned and flown."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import matplotlib.pyplot as plt
import numpy as np
from matplotlib import rc_context

from trimtab.host.report.figures import AFTER, BEFORE, STYLE, Figure, finish

_COLOURS = (BEFORE, AFTER)
_SPREAD = 0.11
"""Greatest distance of a point from the middle of its box, to keep points apart."""


def boxes(errors_mm: Mapping[str, Mapping[str, Sequence[float]]], caption: str) -> Figure:
    """Draw errors, mm, by group and kind as boxes with all their points; also as PNG.

    Whiskers go from the 5th to the 95th percentile.
    """
    rng = np.random.default_rng(0)
    kinds = list(next(iter(errors_mm.values())))
    with rc_context(STYLE):
        canvas, ax = plt.subplots(figsize=(8.4, 3.8))
        for i, each in enumerate(errors_mm.values()):
            for k, (kind, colour) in enumerate(zip(kinds, _COLOURS, strict=True)):
                values, place = np.asarray(each[kind]), i + 0.34 * (k - 0.5)
                if not len(values):
                    continue
                shaken = place + rng.uniform(-_SPREAD, _SPREAD, len(values))
                ax.plot(shaken, values, ".", color=colour, alpha=0.18, markersize=2.5, zorder=1)
                ax.boxplot(
                    values,
                    positions=[place],
                    widths=0.24,
                    whis=(5.0, 95.0),
                    showfliers=False,
                    manage_ticks=False,
                    boxprops={"color": colour},
                    whiskerprops={"color": colour},
                    capprops={"color": colour},
                    medianprops={"color": colour, "linewidth": 2.0},
                )
        for kind, colour in zip(kinds, _COLOURS, strict=True):
            ax.plot([], [], "s", color=colour, label=kind)
        ax.set_xticks(range(len(errors_mm)), list(errors_mm))
        ax.set(ylabel="position error, mm", ylim=(0.0, None))
        ax.legend(frameon=False)
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
