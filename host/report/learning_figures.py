"""Figures of the study of learning: learning curves, errors over noise, errors of flights in drawn worlds."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib import rc_context

from trimtab.host.report.figures import AFTER, BEFORE, FLOOR, NEUTRAL, STYLE, Figure, finish

_COLOURS = (AFTER, BEFORE, "#5a9bb0", "#d59a87")


def learning_curves(panels: Mapping[str, Sequence[Mapping[str, Any]]], caption: str) -> Figure:
    """Draw the loss over epochs, one panel for each setting with all its trials; also as PNG.

    Trials hold train_loss (epochs,) and validation_loss (epochs + 1,).
    """
    with rc_context(STYLE):
        canvas, axes = plt.subplots(1, len(panels), figsize=(3.4 * len(panels), 3.2), squeeze=False)
        for ax, (title, trials) in zip(axes[0], panels.items(), strict=True):
            for k, trial in enumerate(trials):
                train, checks = trial["train_loss"], trial["validation_loss"]
                names = (None, None) if k else ("training", "validation")
                ax.plot(range(1, len(train) + 1), train, color=AFTER, linewidth=1.0, label=names[0])
                ax.plot(range(len(checks)), checks, color=BEFORE, linewidth=1.0, label=names[1])
            ax.set(yscale="log", xlabel="epoch", title=title)
        axes[0, 0].set_ylabel("trajectory loss of a segment")
        axes[0, 0].legend(frameon=False)
    ends = ", ".join(
        f"{title}: {min(t['validation_loss'][-1] for t in trials):.2g} to "
        f"{max(t['validation_loss'][-1] for t in trials):.2g}"
        for title, trials in panels.items()
    )
    return finish(canvas, caption, f"Learning curves; validation loss at the end, {ends}.", png=True)


def over_noise(rows: Sequence[Mapping[str, Any]], caption: str) -> Figure:
    """Draw the test error over the noise, one panel for each regressor, one line a method; also as PNG.

    Rows hold regressor, scale, method and test (m/s^2).
    """
    regressors = list(dict.fromkeys(row["regressor"] for row in rows))
    methods = list(dict.fromkeys(row["method"] for row in rows))
    with rc_context(STYLE):
        canvas, axes = plt.subplots(
            1, len(regressors), figsize=(3.4 * len(regressors), 3.6), squeeze=False, sharey=True
        )
        for ax, regressor in zip(axes[0], regressors, strict=True):
            for method, colour in zip(methods, _COLOURS, strict=False):
                chosen = [r for r in rows if r["regressor"] == regressor and r["method"] == method]
                line = "-" if "smoothed" in method else "--"
                ax.plot(
                    [r["scale"] for r in chosen],
                    [r["test"] for r in chosen],
                    line,
                    marker="o",
                    markersize=3.5,
                    color=colour,
                    linewidth=1.3,
                    label=method,
                )
            ax.set(yscale="log", xlabel="noise, times nominal", title=regressor)
        axes[0, 0].set_ylabel("acceleration RMSE, m/s$^2$")
        handles, labels = axes[0, 0].get_legend_handles_labels()
        canvas.legend(handles, labels, loc="outside lower center", ncols=2, frameon=False)
    return finish(canvas, caption, "Test error over noise by regressor and method.", png=True)


def over_nominal(
    ratios: Mapping[str, Mapping[str, Sequence[float | None]]],
    names: Mapping[str, str],
    caption: str,
    over: str = "nominal",
) -> Figure:
    """Draw ratios to a baseline, one point for each world or course, one column for each set; also as PNG.

    `ratios` maps set and method to values (worlds,); None, for a divergence, is left out. `over` is the name
    of the baseline.
    """
    methods = list(next(iter(ratios.values())))
    with rc_context(STYLE):
        canvas, ax = plt.subplots(figsize=(8.4, 3.4))
        for i, each in enumerate(ratios.values()):
            for k, (method, colour) in enumerate(zip(methods, _COLOURS, strict=False)):
                values = [value for value in each[method] if value is not None]
                place = i + 0.22 * (k - 0.5 * (len(methods) - 1))
                ax.plot([place] * len(values), values, "o", color=colour, alpha=0.6, markersize=4.5)
                if values:
                    ax.plot(place, np.median(values), "_", color=colour, markersize=18, markeredgewidth=2.5)
        for k, (method, colour) in enumerate(zip(methods, _COLOURS, strict=False)):
            ax.plot([], [], "o", color=colour, label=names[method] if k < len(methods) else None)
        ax.axhline(1.0, color=NEUTRAL, linewidth=0.8)
        ax.axhline(0.0, color=FLOOR, linewidth=0.8)
        ax.set_xticks(range(len(ratios)), list(ratios))
        ax.set(ylabel=f"ratio to {over}")
        ax.legend(frameon=False, fontsize=8)
    medians = "; ".join(
        f"{name}: " + ", ".join(f"{method} {_median(values)}" for method, values in each.items())
        for name, each in ratios.items()
    )
    alt = f"Ratio to {over}, medians {medians}."
    return finish(canvas, caption, alt, png=True)


def _median(values: Sequence[float | None]) -> str:
    known = [value for value in values if value is not None]
    return f"{np.median(known):.2f}" if known else "diverged"
