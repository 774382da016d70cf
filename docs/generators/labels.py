"""Generate docs/studies/labels.md, on the labels of the paper's Neural-C, from the study's report.

`python docs/generators/labels.py study-labels-SEED/report.json FILE` writes it.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from trimtab.host.apps.paper.controllers.models import TRAINING_COURSES
from trimtab.host.apps.paper.controllers.statistics import FAILED_M, LEAST_COURSES
from trimtab.host.apps.paper.planning.compare import PACES
from trimtab.host.apps.paper.text import markdown, wrapped
from trimtab.sitl.studies.labels.study import FULL, WORLD
from trimtab.sitl.studies.labels.summary import tables

_HEAD = """# Labels of Neural-C

<!-- Made by docs/generators/labels.py from the study's report; change it there. -->

    {command}
    trimtab study labels --quick

The paper's Neural-C is an MPC whose network was learned from labels of the true acceleration (section V-B).
A real vehicle has no such labels, so the [study of controllers](paper-controllers.md) learns it from smoothed
logs. This study learns it both ways and flies both on the same plans. An interrupted study resumes. `--quick`
flies one course in one world on one trajectory.

Results of seed {seed}, {worlds}, commit {git}, {flights} held-out flights.{quick}

"""

_METHOD = """## Method

**Worlds.** Each is `{world}` with a seed of its own: drag of the paper's form, tolerances, turbulence and
sensor noise, through firmware and radio.

**Training.** {training} flights of {courses} courses at paces {paces}, flown by the flatness-based law.
They give all models of the study of controllers: the residual of the paper's regressor and of ours, and a
network from smoothed labels for each. The two networks from smoothed labels have twins, with the same
flights, layout, settings, seed and split.

**True labels.** The simulator records the plant's acceleration on a grid of 5 ms while the training flights
are flown; the record changes no byte of a log. The label of a sample is this acceleration at the sample's
time in place of the smoothed one. Velocity, attitude and thrusts stay those of the log. The acceleration
holds all that acts on the plant, turbulence included. Models from true labels say so in their provenance
and file name (`paper-labels-truth`, `ours-labels-truth`). They stay in the study's folder.

**Flights.** {held_out} held-out courses of nine waypoints in each world, in the least time in which
Min-Snap keeps the limits. For each regressor, {trajectories} are planned once, and all four MPCs fly the
same plans: Nomi (nominal vehicle), Neural (learned residual), Neural-C from smoothed labels, and Neural-C
from true labels. All flights of a course share noise, turbulence and battery.

**Statistics.** A ratio is of mean tracking errors on the same plan: the median within a course, then over
courses. Intervals are 95 % of bootstraps over courses, from {least} courses on. Courses of a world share
its networks, so the medians of each world stand beside the interval. Tests are Wilcoxon signed-rank tests
with Holm's correction over all ratios. A plan or a flight that failed counts as an error of {failed:g} m.

**Labels.** *Smoothed less true* is the error of the smoothed labels over the training samples. *True
residual* is what the networks are to learn: the true acceleration less that of the nominal vehicle.
*Between networks* is how much the two twins differ at the states of the training samples.

"""


def page(report: Mapping[str, Any]) -> str:
    """Return the page as Markdown for the JSON of a study's report."""
    head = _HEAD.format(
        command=report["provenance"]["command"],
        seed=report["seed"],
        worlds="1 world" if report["worlds"] == 1 else f"{report['worlds']} worlds",
        git=report["provenance"]["git"],
        flights=report["flights"],
        quick=" These are quick development figures, not for the record." if report["quick"] else "",
    )
    method = _METHOD.format(
        world=WORLD,
        training=TRAINING_COURSES * len(PACES),
        courses=TRAINING_COURSES,
        paces=" and ".join(f"{pace:g}" for pace in PACES),
        held_out=FULL.courses,
        trajectories=" and ".join(FULL.trajectories),
        least=LEAST_COURSES,
        failed=FAILED_M,
    )
    sections = [f"### {title}\n\n{markdown(rows)}\n" for title, rows in tables(report).items()]
    return f"{wrapped(head)}{wrapped(method)}## Results\n\n" + "\n".join(sections)


if __name__ == "__main__":
    report = json.loads(Path(sys.argv[1]).read_text("utf-8"))
    Path(sys.argv[2]).write_text(page(report), encoding="utf-8")
