"""Generate docs/studies/paper-controllers.md, on sections V-B, V-C and VI-D, from the study's report.

`python docs/generators/paper_controllers.py study-paper-controllers-SEED/report.json FILE` writes it.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from trimtab.host.apps.paper.controllers.claims import WORDS
from trimtab.host.apps.paper.controllers.design import COURSES, SPEEDS
from trimtab.host.apps.paper.controllers.models import PAPER_SETTINGS, TRAINING_COURSES
from trimtab.host.apps.paper.controllers.needs import COUNTS, EXCITATIONS, TARGET
from trimtab.host.apps.paper.controllers.pieces import PAPER_DURATION_S
from trimtab.host.apps.paper.controllers.statistics import FAILED_M
from trimtab.host.apps.paper.controllers.table import CONTROLLERS, FAMILIES, REGRESSORS
from trimtab.host.apps.paper.controllers.tables import interval, tables
from trimtab.host.apps.paper.planning.compare import NODES, PACES
from trimtab.host.apps.paper.text import markdown, wrapped

_HEAD = """# The paper's controllers, compared

<!-- Made by docs/generators/paper_controllers.py from the study's report; change it there. -->

    {command}
    trimtab study paper-controllers --quick

This study flies the paper's controllers on its trajectories (sections V-B, V-C and VI-D), through firmware
and radio, in sealed worlds. It tests each claim of the paper about them twice: with the paper's way of
learning and with ours. It writes its pieces, models, tables, a page and box plots to its folder. An
interrupted study resumes. `--quick` flies one course of each kind; most claims need more.

Results of seed {seed}, {worlds}, commit {git}, {flights} flights of the balanced design.{quick}

"""

_UNCONFIRMED = """## Claims of the paper that these flights do not confirm

An effect is a ratio of errors, below 1 where the claim holds.

{claims}

"""

_ANSWERS = """## Answers

{answers}

"""

_METHOD = """## Method

**Controllers.** [How the controllers work](../concepts/controllers.md) describes them. The flatness-based
law (DFBC) flies alone (Nomi), with the disturbance observer (DO), with the learned residual fed forward
(Neural), and with both (Neural DO). The MPC predicts with the nominal vehicle (Nomi), with an L1-adaptive
estimate (L1adapt), with the learned residual (Neural), and with a network learned from labels of the
acceleration (Neural-C). *Traced* has the closed form of the drag alone in place of the network; the paper
has no such controller.

**Trajectories.** Min-Snap, Min-Control, Min-Control-R, Min-Residual and Min-Residual* of a course have the
same waypoints, time and limits. *min-error*, which is not the paper's, minimises the
[tracking error](../concepts/planning.md#residual-or-tracking-error) that the residual causes in the loop of
the baseline; only the baseline flies it.

**Regressors.** *paper*: an MLP 2 x 32 on velocity and Euler angles in the world frame, learned as in section
V-A: Adam at {rate:g}, segments of 50 nodes, batches of {batch}, {epochs} epochs, starts as measured. *ours*:
what `trimtab learn` selects by default, with a network in the body frame: nothing, the effects, or effects
and network. Both learn from the same {training} flights of {courses} other courses in their world, flown by
the baseline at paces {paces}. Neural-C learns from labels that the logs give, not from the true drag as in
the paper; [another study](labels.md) flies both.

**Balanced design.** Each world has {per_world} held-out courses of nine waypoints and three speeds: the
least time in which Min-Snap keeps the limits, times {speeds}. A cell is a course at one speed. It flies one
of four sets, DFBC or MPC with the paper's or our regressor, with all controllers of the set on all five
trajectories. The set is (course + speed) mod 4, a Youden square: in every world each set flies once at each
speed, on three different courses, and each pair of sets shares two courses. All flights of a cell share
noise, turbulence and battery. The baseline also flies in the cells of the MPC, on four trajectories.

**A course like the paper's.** {duration:g} s, {nodes} nodes, lambda_r = 0.1. Three such courses, in a world
of their own, fly every controller on every trajectory. They select the best controller and trajectory. One of
them also flies with a wired host, as in the paper's simulation (`wired`), and in a world of seven effects
(`rich`). These two select nothing.

**Trajectory of the baseline.** In the same world, three other courses at the three speeds, planned with the
settings of the balanced design, select a residual trajectory and a regressor for the baseline. What tuning
courses select is measured on the held-out courses.

**Statistics.** The unit is the course. Effects are ratios of mean tracking errors in the same cell, their
median within a course, and the median over courses. Intervals are 95 % of bootstraps over courses. Tests are
Wilcoxon signed-rank tests, with Holm's correction over all claims. A claim is confirmed if the interval of
each of its comparisons is below 1. A plan or a flight that failed counts as an error of {failed:g} m, more
than the diagonal of the room, in every figure, and is listed below.

**What a network needs.** Networks learn from {counts} flights, gentle (paces {gentle}) or aggressive (paces
{aggressive}), in the world or the body frame, with the default method of `trimtab learn` and without a closed
form of the drag. The measure is the error of the baseline on Min-Residual over that on Min-Snap on held-out
courses; {target:g} counts as reached. A plan keeps to the region of the training flights. Where no such plan
exists, it ignores the region, and the network extrapolates. Where a plan or flight failed, the ratio counts
as {failed:g}.

"""


def page(report: Mapping[str, Any]) -> str:
    """Return the page as Markdown for the JSON of a study's report."""
    head = _HEAD.format(
        command=report["provenance"]["command"],
        seed=report["seed"],
        worlds="1 world" if report["quick"] else f"{report['worlds']} worlds",
        git=report["provenance"]["git"],
        flights=report["flights"],
        quick=" This is a quick check, not for the record." if report["quick"] else "",
    )
    sections = [f"### {title}\n\n{markdown(rows)}\n" for title, rows in tables(report).items()]
    return f"{wrapped(head)}{_unconfirmed(report)}{_answers(report)}{_method()}## Results\n\n" + "\n".join(
        sections
    )


def _unconfirmed(report: Mapping[str, Any]) -> str:
    lines = [
        f"- {WORDS[row['claim']]}: {FAMILIES[row['family']]} with {REGRESSORS[row['regressor']]}, "
        f"{interval(row['effect'], row['ci95'])}"
        for row in report["claims"]
        if not row["confirmed"] and row["ci95"] is not None
    ]
    return wrapped(_UNCONFIRMED.format(claims="\n".join(lines))) if lines else ""


def _answers(report: Mapping[str, Any]) -> str:
    """Return what the figures say about the study's questions, one line each."""
    lines = []
    ratio, best = report["error_ratio_baseline"], report["best"]
    if ratio is not None and ratio["ci95"] is not None:
        lines.append(
            f"Better reference, baseline: {ratio['trajectory']} with {REGRESSORS[ratio['regressor']]} leaves "
            f"{interval(ratio['median'], ratio['ci95'])} of the error on min-snap."
        )
    if best is not None and best["ci95"] is not None:
        title = next(each.title for each in CONTROLLERS if each.name == best["controller"])
        lines.append(
            f"Better controller: {title} on {best['trajectory']} with {REGRESSORS[best['regressor']]} leaves "
            f"{interval(best['median'], best['ci95'])} of the error of the baseline on min-snap."
        )
    needs = report["needs"]
    reached = [_setting(row) for row in needs if row["reached"]]
    if needs:
        lines.append(
            f"Networks whose Min-Residual plans reach {TARGET:g} of the error on Min-Snap: "
            f"{'; '.join(reached) or 'none'}."
        )
    return wrapped(_ANSWERS.format(answers="\n".join(f"- {line}" for line in lines))) if lines else ""


def _setting(row: Mapping[str, Any]) -> str:
    beyond = "" if row["within_region"] else ", plans beyond its region"
    return (
        f"{row['frame']} frame, {row['training_flights']} {row['excitation']} flights{beyond}, "
        f"{interval(row['median'], row['ci95'])}"
    )


def _method() -> str:
    text = _METHOD.format(
        rate=PAPER_SETTINGS.rate,
        batch=PAPER_SETTINGS.batch,
        epochs=PAPER_SETTINGS.epochs,
        training=TRAINING_COURSES * len(PACES),
        courses=TRAINING_COURSES,
        paces=_numbers(PACES),
        per_world=COURSES,
        speeds=_numbers(SPEEDS.values()),
        duration=PAPER_DURATION_S,
        nodes=NODES,
        failed=FAILED_M,
        counts=_numbers(COUNTS),
        gentle=_numbers(EXCITATIONS["gentle"]),
        aggressive=_numbers(EXCITATIONS["aggressive"]),
        target=TARGET,
    )
    return wrapped(text)


def _numbers(values: Iterable[float]) -> str:
    return ", ".join(f"{value:g}" for value in values)


if __name__ == "__main__":
    report = json.loads(Path(sys.argv[1]).read_text("utf-8"))
    Path(sys.argv[2]).write_text(page(report), encoding="utf-8")
