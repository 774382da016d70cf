"""The piece of a world that nobody flew."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from trimtab.host.apps.paper.flight.controllers import (
    BASELINE,
    MPC,
    MPC_L1,
    MPC_NEURAL,
    NEURAL,
    NEURAL_OBSERVER,
    OBSERVER,
    TABLE_III,
)
from trimtab.host.apps.paper.flight.models import AHEAD, AHEAD_SAME_TORQUE, FLIGHTS, OURS, PAPER, SEGMENTS
from trimtab.host.apps.paper.flight.pretzel import KINDS, MIN_RESIDUAL
from trimtab.host.apps.paper.flight.world import NOMINAL, SETS

NOMINAL_M = 0.1


def errors(ratio: float, horizons: Sequence[str]) -> dict[str, Any]:
    """Errors of which the paper's settings leave this share of the nominal model's, and ours half as much."""
    shares = {NOMINAL: 1.0, PAPER: ratio, OURS: 0.5 * ratio}
    return {
        model: {
            horizon: {"position_rmse_m": share * NOMINAL_M, "velocity_rmse_m_s": 2.0 * share * NOMINAL_M}
            for horizon in horizons
        }
        for model, share in shares.items()
    }


def flight(kind: str, law: str, index: int, mean_m: float) -> dict[str, Any]:
    return {
        "kind": kind,
        "controller": law,
        "flight": index,
        "error_mean_m": mean_m,
        "error_max_m": 2.0 * mean_m,
        "constant_ned_m": [0.0, 0.03, 0.04],
        "varying_mean_m": mean_m - 0.05,
        "clipped_share": 0.0,
        "errors_m": [0.5 * mean_m, mean_m, 2.0 * mean_m],
        "path_ned_m": [[0.0, 0.0, -1.0], [1.0, 0.5, -1.2], [2.0, 0.0, -1.0]],
    }


def made_up_world(world: int = 0, *, ratio: float = 0.5, error_m: float = 0.1) -> dict[str, Any]:
    """A world in which minimum residual flies with 0.8 of the error of minimum snap."""
    moves = {
        f"{quantity}_{what}": 1.0
        for quantity in ("speed_m_s", "acceleration_m_s2", "jerk_m_s3")
        for what in ("mean", "sd")
    }
    plan = {
        "acceleration_max_m_s2": 9.0,
        "acceleration_mean_m_s2": 4.0,
        "jerk_max_m_s3": 20.0,
        "jerk_mean_m_s3": 9.0,
        "residual_rms_m_s2": 1.0,
        "path_length_m": 20.0,
        "legs_length_m": 18.0,
        "path_ned_m": [[0.0, 0.0, -1.0], [1.0, 0.5, -1.2], [2.0, 0.0, -1.0]],
    }
    return {
        "world": world,
        "statistics": {"known": moves, "ood": moves},
        "flights": {"train": 13, "test": 3, "ood": 3},
        "selected": "effects and network",
        "network": True,
        "errors": {name: errors(ratio, (FLIGHTS, SEGMENTS)) for name in SETS},
        "controllers": {
            **{
                law: errors(ratio, (FLIGHTS, AHEAD, AHEAD_SAME_TORQUE))
                for law in (BASELINE, OBSERVER, NEURAL, NEURAL_OBSERVER)
            },
            **{law: errors(ratio, (AHEAD, AHEAD_SAME_TORQUE)) for law in (MPC, MPC_L1, MPC_NEURAL)},
        },
        "pretzel": {
            "plans": {kind: dict(plan) for kind in KINDS},
            "flights": [
                flight(kind, law, index, error_m * (0.8 if kind == MIN_RESIDUAL else 1.0))
                for kind in KINDS
                for law in TABLE_III
                for index in (101, 102)
            ],
            "failed": None,
        },
        "failed": [],
    }
