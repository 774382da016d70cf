"""The table of peers: a row for each one that was measured, with bounds and floors."""

from __future__ import annotations

from typing import Any

import pytest

from trimtab.host.apps.bench import table

MACHINE: dict[str, Any] = {"lanes": 4, "features": [], "peak_gflops": 10.0}
LEARNING: dict[str, Any] = {
    "gradient_ms": 2.0,
    "gradient_vm_ms": 40.0,
    "gradient_weights": 1000,
    "gradient_points": 2000,
    "peers": [{"name": "JAX", "gradient_ms": 10.0}],
}
PLANNING: dict[str, Any] = {
    "naive": {"nodes": 400, "ours_s": 0.2, "seconds": 300.0, "at_least": True},
    "rockit": None,
    "minsnap_trajectories": None,
}
CONTROL: dict[str, Any] = {
    "mpc_solve_ms_p99": 1.5,
    "stages": 20,
    "iterations_mean": 2.0,
    "naive": {"ms": 60.0, "ours_ms": 1.0},
}


def test_answer_has_a_row_for_each_peer_and_the_solver_of_the_mpc_under_planning() -> None:
    answer = table.answer(machine=MACHINE, learning=LEARNING, planning=PLANNING, control=CONTROL)
    assert answer["planning"]["mpc_solve_ms_p99"] == 1.5
    assert "mpc_solve_ms_p99" not in answer["control"]
    rows = {(row["task"], row["peer"]): row for row in answer["peers"]}
    assert [task for task, _ in rows] == [
        "gradient, 10 x 49 steps",
        "gradient, 10 x 49 steps",
        "first solve, 400 intervals",
        "MPC, one solve",
    ]
    jax = rows["gradient, 10 x 49 steps", "JAX"]
    assert (jax["over_ours"], jax["floor_ms"]) == (5.0, 1.2)
    assert rows["first solve, 400 intervals", "CasADi map and Ipopt"]["over_ours"] == 1500.0
    recursion = 2 * 13 * 13 * 17 + 2 * 13 * 17 * 17
    assert rows["MPC, one solve", "CasADi map and Ipopt"]["floor_ms"] == pytest.approx(
        2.0 * 21 * recursion * 1e-7
    )
    lines = table.peer_lines(answer["peers"])
    assert len(lines) == 1 + len(rows)
    assert ">=1500.0" in lines[3]


def test_without_a_compiler_the_gradient_is_the_virtual_machines() -> None:
    learning = {**LEARNING, "gradient_ms": None}
    rows = table.peer_rows({**MACHINE, "peak_gflops": None}, learning, PLANNING, CONTROL)
    assert [row["peer"] for row in rows if row["task"].startswith("gradient")] == ["JAX"]
    assert rows[0]["over_ours"] == 0.25
    assert rows[0]["floor_ms"] is None
