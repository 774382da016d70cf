"""Generate docs/studies/paper-flight.md, on the paper's section VI, from the study's report.

`python docs/generators/paper_flight.py study-paper-flight-SEED/report.json FILE` writes it.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from trimtab.host.apps.paper.flight import courses, world
from trimtab.host.apps.paper.flight.models import PAPER_SETTINGS, SEGMENT_STEPS
from trimtab.host.apps.paper.flight.pretzel import LAMBDA_R, NODES
from trimtab.host.apps.paper.paths import Room
from trimtab.host.apps.paper.text import markdown, wrapped
from trimtab.host.learn.ahead import AHEAD_S

_HEAD = """# The paper's flight section, compared

<!-- Made by docs/generators/paper_flight.py from the study's report; change it there. -->

    {command}
    trimtab study paper-flight --quick

This study repeats section VI of the paper through the whole chain: plan, upload, firmware, radio, log,
learn, plan again. Reality is a sealed world. The study writes its pieces, logs, tables, a page and pictures
to its folder. An interrupted study resumes. `--quick` flies one world.

Results of seed {seed}, {worlds}, commit {git}.{quick}

"""

_METHOD = """## Method

**Worlds.** `{world}` holds seven effects with drawn sizes: linear and quadratic drag, thrust inflow,
translational lift, wind, battery sag and an offset of the centre of mass, with tolerances and turbulence.
Their forms in the plant [differ from the
host's](../concepts/simulator.md#the-plant-is-not-the-hosts-model). The host sees only logs. World, courses,
split and first weights are drawn from the study's seed. Sizes of effects, room, paces
and the weight of thrust rates were chosen on seeds 9000 to 9005.

**Data (VI-B).** Four random paths of twenty waypoints are joined by minimum snap with optimised times. Each
path takes {duration:g} s at pace 1 and is flown at the paces {paces}: sixteen flights of {shortest:.0f} to
{longest:.0f} s. The waypoints are in a box of {box}, with legs of {legs}. Three paths out of distribution
have other waypoints in a box of {ood_box}, legs of {ood_legs} and the paces {ood_paces}. The paper prints
no room, legs or decay rates. These inputs were chosen for statistics near the paper's table I. The test has
{test} of the sixteen flights, drawn at random; the others are learned from. Flights of one path at
different paces may be on both sides of the split.

**Learning, the paper's settings.** An MLP 3 x 32 on velocity and Euler angles; Adam at 1e-3, batches of
{batch}, segments of {nodes} nodes at 0.02 s, L = diag(1, 1, 0, .1, .1, 0, .1, .1, 0, 0, 0, 0), {epochs}
epochs. Segments start at the measured state. What the paper leaves open: the step size falls to a hundredth
over the epochs, the reference moves inside a step, and the network of the epoch with the least training
loss is taken.

**Learning, ours.** The defaults of `trimtab learn`: linear drag, centre of mass and an MLP 2 x 32, by the
condensed loss with free starts. The model is the one that predicts the whole training flights best:
nothing, the effects, or effects and network. Flights of the test are not used.

**Prediction error (VI-C).** RMSE of the norm over all samples, by the closed-loop model with estimator and
delay. The paper does not say over which horizon it predicts. *Whole flights* run from the first tracked
state to the end, driven by the reference alone. *Segments* run over {nodes} nodes from a measured state.
The ratio (`prediction_ratio` with `--json`) is that of positions of whole flights, the median over worlds.

**Pretzel (VI-D).** The shipped route `pretzel`: seven waypoints, {steps} steps of 0.03 s. Minimum residual
is planned with our model and nominal dynamics, within the same waypoints, time and limits, with lambda_r
{lambda_r:g} per N^2. The paper's cost has no thrust rates; they weigh as much beside the control effort as
in the planner's defaults. The paper's own waypoints are not printed, so its accelerations belong to another
course. *Baseline* is the flatness-based law. *DO* adds the disturbance observer. Both have the settings of
[the tuning](controller-tuning.md), which used other worlds; the pretzel is one of its courses. *Neural DO*
adds the feed-forward of our model, and the observer estimates only the remainder. All combinations of a
world fly with the same flight indices, so with the same noise, turbulence and battery.
Intervals are 95 % of bootstraps over worlds, and over flights inside each world.

The baseline has no integral: a residual that is constant over a flight, such as the thrust that a low battery
lacks or the push of wind, leaves a constant error that both plans share. The planner's cost does not count it
([planning](../concepts/planning.md)). The second table of the pretzel splits each flight's error into its
mean vector, the constant part, and the rest. It also has the lengths of the paths: drag grows with speed, the
time is fixed, and no path is shorter than the straight lines between the waypoints. Their ratio to the
minimum-snap path limits the mean speed that a plan can save.

**Remark 1.** The models are learned from flights of the baseline. Other controllers then fly the test's
references, and the same models predict those flights: DO, the feed-forward alone and Neural DO on board,
and three [controllers on the host](../concepts/controllers.md): nominal MPC, L1-adaptive MPC, and the MPC
whose prediction has our model. Two horizons are reported. *Whole flight*: the model predicts the flight
from its reference, through the law on board. It does not know the controllers on the host, so those
flights have no such row. *{ahead_s:g} s ahead*: the recorded motor commands drive the model from measured
states, end to end over the flight; every controller has such a row, and `trimtab learn --hold-out` scores
flights by a controller on the host so. Compare ratios within one horizon. Most of the nominal error
{ahead_s:g} s ahead is a torque, not an acceleration: the rate loop balances the offset of the centre of
mass, and motor commands alone do not. The paper's settings learn an acceleration, ours that torque too.
*With the same torque in all models*, the constant torque of ours, the models differ in the acceleration
alone. The converse, a model learned from flights of an MPC, is not measured: `trimtab learn` predicts the
flights that it learns from by the law on board, and refuses those of a controller on the host.

"""


def page(report: Mapping[str, Any]) -> str:
    """Return the page as Markdown for the JSON of a study's report."""
    tables = dict(report["tables"])
    worse = "Worse than in the paper"
    count = len(report["selected"])
    head = _HEAD.format(
        command=report["provenance"]["command"],
        seed=report["seed"],
        worlds=f"{count} world{'s' if count > 1 else ''}",
        git=report["provenance"]["git"],
        quick=" This is a quick check, not for the record." if report["quick"] else "",
    )
    rows = tables.pop(worse)
    sections = [f"### {title}\n\n{markdown(rows)}\n" for title, rows in tables.items()]
    return f"{wrapped(head)}## {worse}\n\n{_list(rows)}\n{_method()}## Results\n\n" + "\n".join(sections)


def _method() -> str:
    durations = [courses.ROOM.duration_s / pace for pace in courses.PACES]
    text = _METHOD.format(
        world=world.WORLD,
        duration=courses.ROOM.duration_s,
        paces=_numbers(courses.PACES),
        shortest=min(durations),
        longest=max(durations),
        box=_box(courses.ROOM),
        legs=_legs(courses.ROOM),
        ood_box=_box(courses.OOD_ROOM),
        ood_legs=_legs(courses.OOD_ROOM),
        ood_paces=_numbers(courses.OOD_PACES),
        test=world.TEST_FLIGHTS,
        batch=PAPER_SETTINGS.batch,
        nodes=SEGMENT_STEPS + 1,
        epochs=PAPER_SETTINGS.epochs,
        steps=NODES,
        lambda_r=LAMBDA_R,
        ahead_s=AHEAD_S,
    )
    return wrapped(text)


def _list(rows: Sequence[Mapping[str, str]]) -> str:
    """Return the figures that are worse than the paper's as a list."""
    lines = []
    for row in rows:
        numbers = f": {row['ours']}, in the paper {row['paper']}" if row["ours"] else ""
        lines.append(f"- {row['figure']}{numbers}")
    return "\n".join(lines) + "\n"


def _numbers(values: Sequence[float]) -> str:
    return ", ".join(f"{value:g}" for value in values)


def _box(room: Room) -> str:
    return " x ".join(f"{edge:g}" for edge in room.box_m) + " m"


def _legs(room: Room) -> str:
    return f"{room.leg_m[0]:g} to {room.leg_m[1]:g} m"


if __name__ == "__main__":
    report = json.loads(Path(sys.argv[1]).read_text("utf-8"))
    Path(sys.argv[2]).write_text(page(report), encoding="utf-8")
