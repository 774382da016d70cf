"""Learning on the data of the paper's section V-A: a mini-batch's gradient, Adam, the condensed loss."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from trimtab.host.apps.bench import peers
from trimtab.host.apps.bench.timing import best_ms
from trimtab.host.apps.paper.learning.flights import STEP_S, make_flights
from trimtab.host.apps.paper.learning.measure import acceleration_error
from trimtab.host.apps.paper.learning.methods import (
    PAPER_BATCH,
    PAPER_EPOCHS,
    PAPER_MLP,
    SHORT,
    WEIGHT,
    WORLD,
    condensed,
    condensed_settings,
    exact_segments,
    paper,
    phi_of,
)
from trimtab.host.codegen.compiler import wanted_compiler
from trimtab.host.learn.adjoint import Rollouts
from trimtab.host.learn.lanes import LaneRollouts
from trimtab.host.vehicle import Vehicle

GRADIENT_STEPS = ("flights", "gradient", "gradient, virtual machine", "peers")
STEPS = (*GRADIENT_STEPS, "Adam", "condensed")
_REPEATS = 100


def measure(
    vehicle: Vehicle,
    seed: int,
    on_progress: Callable[[str], None] = lambda step: None,
    *,
    epochs: int = PAPER_EPOCHS,
    iterations: int = SHORT,
    repeats: int = _REPEATS,
    counts: dict[str, int] | None = None,
    training: bool = True,
) -> dict[str, Any]:
    """Return times on one core, and with `training` the final errors of the condensed loss.

    `gradient_ms` is for 10 segments of 49 steps and a network of 2 x 32, in C; None without a compiler.
    `gradient_vm_ms` is the same in CasADi's virtual machine. `peers` are the same by JAX and diffrax, with
    `over_ours` the ratio to our best; None if they are not installed. `on_progress` is called with each of
    STEPS as it begins, or of GRADIENT_STEPS without training. `counts` are flights by set.
    """
    on_progress(STEPS[0])
    sets = make_flights(vehicle, seed, counts=counts)
    phi = phi_of(sets["train"], WORLD)
    train, validation = (exact_segments(phi, sets[name]) for name in ("train", "validation"))
    xi = PAPER_MLP.initial(np.random.default_rng(seed))
    batch = train.take(np.arange(PAPER_BATCH))
    theta = phi.theta_neutral
    compiler = wanted_compiler()
    on_progress(STEPS[1])
    lanes_ms = None
    if compiler is not None:
        lanes = LaneRollouts(phi, PAPER_MLP, theta, step_s=STEP_S, weight=WEIGHT, compiler=compiler)
        lanes_ms = best_ms(lambda: lanes.gradient(batch, batch.x0, xi), repeats=repeats)
    on_progress(STEPS[2])
    machine = Rollouts(phi, PAPER_MLP, theta, batch=PAPER_BATCH, step_s=STEP_S, weight=WEIGHT)
    machine_ms = best_ms(lambda: machine.gradient(batch, batch.x0, xi), repeats=repeats)
    on_progress(STEPS[3])
    ours, best_of_ours_ms = machine.gradient(batch, batch.x0, xi), lanes_ms or machine_ms
    beside = peers.measure(phi, PAPER_MLP, batch, xi, WEIGHT, ours, repeats=repeats)
    if beside is not None:
        beside = [{**row, "over_ours": row["gradient_ms"] / best_of_ours_ms} for row in beside]
    gradient = {
        "gradient_ms": lanes_ms,
        "gradient_vm_ms": machine_ms,
        "gradient_weights": PAPER_MLP.size,
        "gradient_points": 4 * batch.count * batch.steps,
        "peers": beside,
    }
    if not training:
        return gradient
    on_progress(STEPS[4])
    adam = paper(phi, train, validation, seed, layout=PAPER_MLP, weight=WEIGHT, epochs=epochs)
    on_progress(STEPS[5])
    settings = condensed_settings(PAPER_MLP, iterations, passes=1)
    quick = condensed(phi, train, validation, seed, settings, weight=WEIGHT)
    return {
        **gradient,
        "adam_100_s": adam.seconds,
        "adam_test_rmse": acceleration_error(adam.candidate, sets["test"]).pointwise,
        "condensed_s": quick.seconds,
        "test_rmse": acceleration_error(quick.candidate, sets["test"]).pointwise,
        "ood_rmse": acceleration_error(quick.candidate, sets["ood"]).pointwise,
    }
