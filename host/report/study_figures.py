"""Figures of the blind study: probabilities that are right, and effects found by size."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib import rc_context

from trimtab.host.report.figures import AFTER, FLOOR, NEUTRAL, STYLE, Figure, finish


def reliability(given: Mapping[str, Mapping[str, Any]]) -> Figure:
    """Draw the share of effects that are there over the probability given to them; also as PNG.

    `given` maps the kind of data to its `bins`, with edges `low` and `high`, mean probability `mean`, share
    `there`, exact `interval` and count `n`. There is a panel for each kind of data.
    """
    edges = sorted({(each["low"], each["high"]) for found in given.values() for each in found["bins"]})
    places = {low: place for place, (low, _) in enumerate(edges)}
    with rc_context(STYLE):
        canvas, axes = plt.subplots(
            1, len(given), figsize=(0.6 + 2.6 * len(given), 3.4), squeeze=False, sharex=True, sharey=True
        )
        for ax, (data, found) in zip(axes[0], given.items(), strict=True):
            _bins(ax, found["bins"], places)
            ax.set(title=f"{data} ({found['n']})", ylim=(-0.02, 1.02), xlabel="probability given")
            labels = [f"{low:g}-{high:g}" for low, high in edges]
            ax.set_xticks(range(len(edges)), labels, rotation=60, ha="right", rotation_mode="anchor")
        axes[0, 0].set_ylabel("share that is there")
    sure = ", ".join(
        f"{data} {100 * found['sure']:.0f} % of {found['sure_n']}"
        for data, found in given.items()
        if found["sure_n"]
    )
    return finish(
        canvas,
        "Share of effects that are there over the probability given to them, with exact 95 % intervals and "
        "counts. Grey: mean probability given; where it is within the interval, probabilities may be right.",
        f"Effects given at least 95 % that are there: {sure or 'none was given so much'}.",
        png=True,
    )


def _bins(ax: Any, bins: Sequence[Mapping[str, Any]], places: Mapping[float, int]) -> None:
    """Draw the bins as points with intervals and counts, beside their mean probability."""
    x = np.array([places[each["low"]] for each in bins])
    y = np.array([each["there"] for each in bins])
    low, high = np.array([each["interval"] for each in bins]).T
    ax.plot(x, [each["mean"] for each in bins], "_", color=FLOOR, markersize=16, markeredgewidth=3)
    ax.errorbar(
        x, y, yerr=np.maximum([y - low, high - y], 0.0), fmt="o", color=AFTER, markersize=4, capsize=2
    )
    for place, each in zip(x, bins, strict=True):
        ax.annotate(
            str(each["n"]),
            (place, each["there"]),
            xytext=(4, 5 if each["there"] < 0.5 else -10),
            textcoords="offset points",
            fontsize=7,
            color=NEUTRAL,
        )


_AXES = {"sigma": "separation from the closest alias, sigma", "tolerances": "size, tolerances"}


def detection(curves: Mapping[str, Mapping[str, Any]]) -> Figure:
    """Draw the share of effects found over their size, in total and by kind; also as PNG.

    `curves` maps a measure of the size ("sigma", "tolerances") to `total` and `kinds`: rows with edges `low`
    and `high` (None without one), count `n`, share `found` and exact `interval`.
    """
    kinds = list(curves["sigma"]["kinds"])
    with rc_context(STYLE):
        canvas, axes = plt.subplots(
            2,
            len(curves),
            figsize=(10.4, 3.2 + 0.24 * len(kinds)),
            squeeze=False,
            sharex="col",
            height_ratios=(2.6, 0.6 + 0.24 * len(kinds)),
        )
        for column, (size, found) in zip(axes.T, curves.items(), strict=True):
            edges = sorted({(row["low"], row["high"]) for row in found["total"]}, key=lambda edge: edge[0])
            places = {low: place for place, (low, _) in enumerate(edges)}
            _curve(column[0], found["total"], places)
            _kinds(column[1], found["kinds"], places)
            labels = [f"{low:g}-{high:g}" if high else f">= {low:g}" for low, high in edges]
            column[1].set_xticks(range(len(labels)), labels)
            column[1].set_xlabel(_AXES[size])
        axes[0, 0].set_ylabel("share found")
    shares = ", ".join(
        f"from {row['low']:g} sigma {100 * row['found']:.0f} % of {row['n']}"
        for row in curves["sigma"]["total"]
    )
    return finish(
        canvas,
        "Share of effects found over their size, with exact 95 % intervals, and the counts by kind.",
        f"Effects found: {shares}.",
        png=True,
    )


def _curve(ax: Any, rows: Sequence[Mapping[str, Any]], places: Mapping[float, int]) -> None:
    """Draw the shares of rows with their intervals and counts."""
    x = np.array([places[row["low"]] for row in rows])
    y = np.array([row["found"] for row in rows])
    low, high = np.array([row["interval"] for row in rows]).T
    ax.errorbar(x, y, yerr=np.maximum([y - low, high - y], 0.0), fmt="o-", color=AFTER, capsize=3)
    for place, row in zip(x, rows, strict=True):
        ax.annotate(
            f"{row['n']}",
            (place, row["found"]),
            xytext=(6, -11 if row["found"] > 0.1 else 6),
            textcoords="offset points",
            fontsize=7,
            color=NEUTRAL,
        )
    ax.set_ylim(-0.02, 1.02)


def _kinds(ax: Any, kinds: Mapping[str, Sequence[Mapping[str, Any]]], places: Mapping[float, int]) -> None:
    """Draw a table of counts by kind and size, each cell shaded by its share."""
    shares = np.full((len(kinds), len(places)), np.nan)
    for i, rows in enumerate(kinds.values()):
        for row in rows:
            k = places[row["low"]]
            shares[i, k] = row["found"]
            ax.text(
                k,
                i,
                f"{round(row['found'] * row['n'])}/{row['n']}",
                ha="center",
                va="center",
                fontsize=7,
                color="white" if row["found"] > 0.6 else NEUTRAL,
            )
    ax.imshow(shares, cmap="Blues", vmin=0.0, vmax=1.0, aspect="auto")
    ax.set_yticks(range(len(kinds)), list(kinds))
    ax.grid(visible=False)
