"""What `trimtab bench` says of the MPC: counts of its steps, and the peer on the same problems."""

from __future__ import annotations

from trimtab.host.apps.bench import control
from trimtab.host.vehicle import load_vehicle


def test_figures_are_of_noisy_flights_and_the_peer_finds_the_same_commands() -> None:
    began: list[str] = []
    size = control.Size(steps=400, courses=1, peer_problems=5)
    found = control.measure(load_vehicle("research"), 3, began.append, size=size)
    assert began == list(control.STEPS)
    assert found["steps"] >= size.steps
    assert 0.0 < found["mpc_step_ms_p50"] <= found["mpc_step_ms_p99"]
    assert found["iterations_mean"] > 1.5
    assert (found["budget_spent"], found["infeasible"]) == (0, 0)
    assert 1e-4 < found["error_mean_m"] < 0.02
    naive = found["naive"]
    assert (naive["problems"], naive["failed"]) == (5, 0)
    assert naive["differs"] < 2e-4
    assert naive["over_ours"] == naive["ms"] / naive["ours_ms"]
