"""Draw docs/profile.svg: the parts of a plan's, a trace's and a session's processor time, before and after.

`perf record -e cpu-clock -o DATA COMMAND` makes one file of samples for each bar. The command draws them:

    python docs/generators/profiles.py FILE plan BEFORE AFTER trace BEFORE AFTER session BEFORE AFTER

The samples are grouped by the library that they fall in. It prints the shares as a table.
"""

from __future__ import annotations

import re
import subprocess
import sys
from collections import Counter
from pathlib import Path

import matplotlib as mpl
from matplotlib.figure import Figure

PARTS = {
    "Python": r"python3\.\d+(\.so|$)",
    "our compiled code": r"^[0-9a-f]{32}\.so$",
    "CasADi and its solvers": r"casadi|fatrop|blasfeo|ipopt|mumps",
    "C library and kernel": r"^lib(c|m|stdc\+\+|gcc_s)\.so|^ld-linux|^\[",
}
"""Patterns of the libraries' file names."""

OTHER = "numpy, scipy and other libraries"
COLOURS = dict(zip((*PARTS, OTHER), ("#4c78a8", "#54a24b", "#e45756", "#9d9da3", "#eeca3b"), strict=True))


def samples(data: Path) -> Counter[str]:
    """Return the number of samples of each part in a file of `perf record`."""
    sort = "--no-children -g none --sort dso -F sample,dso --stdio -t ;"
    command = ["perf", "report", "-i", str(data), *sort.split()]
    report = subprocess.run(command, check=True, capture_output=True, text=True).stdout
    counts: Counter[str] = Counter()
    for line in report.splitlines():
        if ";" not in line or line.startswith("#"):
            continue
        number, library = (field.strip() for field in line.split(";"))
        part = next((name for name, pattern in PARTS.items() if re.search(pattern, library)), OTHER)
        counts[part] += int(number)
    return counts


def draw(bars: dict[str, tuple[Counter[str], Counter[str]]], file: Path) -> None:
    """Draw two stacked bars for each command, in percent of the first one's samples."""
    figure = Figure(figsize=(8.0, 3.6), layout="constrained")
    axes = figure.subplots()
    labels = []
    for group, (command, pair) in enumerate(bars.items()):
        whole = pair[0].total()
        for row, (counts, name) in enumerate(zip(pair, ("before", "now"), strict=True)):
            y, left = -(3 * group + row), 0.0
            labels.append((y, f"{command}, {name}"))
            for part, colour in COLOURS.items():
                width = 100 * counts[part] / whole
                axes.barh(y, width, left=left, color=colour, label=part if not labels[1:] else None)
                left += width
            axes.text(left + 1, y, f"{left:.0f} %", va="center")
    axes.set_yticks([y for y, _ in labels], [label for _, label in labels])
    axes.set_xlabel("processor time, per cent of before")
    axes.set_xlim(0, 112)
    axes.spines[["top", "right"]].set_visible(False)
    figure.legend(*axes.get_legend_handles_labels(), loc="outside upper center", ncols=3, frameon=False)
    with mpl.rc_context({"svg.hashsalt": "trimtab"}):
        figure.savefig(file, metadata={"Date": None})


def main() -> None:
    """Draw the picture and print its numbers."""
    file, *words = sys.argv[1:]
    bars = {
        command: (samples(Path(before)), samples(Path(now)))
        for command, before, now in zip(words[::3], words[1::3], words[2::3], strict=True)
    }
    draw(bars, Path(file))
    sys.stdout.write(f"| | {' | '.join(COLOURS)} |\n|---|{'---|' * len(COLOURS)}\n")
    for command, pair in bars.items():
        for counts, name in zip(pair, ("before", "now"), strict=True):
            cells = (f"{100 * counts[part] / pair[0].total():.0f} %" for part in COLOURS)
            sys.stdout.write(f"| {command}, {name} | {' | '.join(cells)} |\n")


if __name__ == "__main__":
    main()
