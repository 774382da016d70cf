"""Logs of a world that nothing declares, traced from the files alone; the truth is opened after the verdict.

`tests/data/truth.json` was written by the simulator when the logs were flown. Only `opened_truth` reads it.
"""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

pytestmark = pytest.mark.xdist_group("sealed")

DATA = Path(__file__).parent / "data"
USED = ("a1.mcap", "a2.mcap", "b1.mcap", "b2.mcap")


@pytest.fixture(scope="module")
def answer(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """What `trimtab trace --json` says of the logs, where there is no simulator."""
    logs = [str(DATA / name) for name in USED]
    code = (
        "import sys; sys.modules['trimtab.sitl'] = None; from trimtab.host.cli import main; sys.exit(main())"
    )
    command = [
        sys.executable,
        "-c",
        code,
        "trace",
        *logs,
        "--hold-out",
        str(DATA / "c1.mcap"),
        "--json",
    ]
    folder = tmp_path_factory.mktemp("trace")
    done = subprocess.run(command, capture_output=True, text=True, cwd=folder, timeout=250, check=False)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout.splitlines()[-1])


def opened_truth(verdict: dict[str, Any]) -> dict[str, dict[str, float]]:
    """The sealed effects; asks for the verdict so that nobody opens them before it."""
    assert verdict["verdict"]
    return json.loads((DATA / "truth.json").read_text())["effects"]


def test_trace_of_sealed_logs_names_missing_effects_alone_and_lists_the_weakest_one_as_possible(
    answer: dict[str, Any],
) -> None:
    """Four flights of this length do not show the weakest effect for sure, the lag: it may stay undecided."""
    named, truth = {effect["name"] for effect in answer["effects"]}, set(opened_truth(answer))
    possible = {effect["name"]: effect["probability"] for effect in answer["possible"]}
    undecided = {effect["name"] for effect in answer["effects"] if effect["aliases"]}
    assert answer["verdict"] == ("undecided" if undecided else "traced")
    assert undecided <= {"motor-lag"}
    assert named <= truth
    assert len(truth - named) <= 1
    assert truth - named <= {name for name, probability in possible.items() if probability > 0.5}


def test_trace_of_sealed_logs_sizes_them_within_its_intervals(answer: dict[str, Any]) -> None:
    neutral = {"gain": 1.0, "factor": 1.0}
    for effect in answer["effects"]:
        for key, true in opened_truth(answer)[effect["name"]].items():
            found, size = effect["parameters"][key]["value"], abs(true - neutral.get(key, 0.0))
            assert abs(found - true) < 0.15 * size, (effect["name"], key)
            assert abs(found - true) < 3.0 * effect["parameters"][key]["sd"], (effect["name"], key)


def test_trace_of_sealed_logs_predicts_the_held_out_flight_near_its_noise_floor(
    answer: dict[str, Any],
) -> None:
    assert answer["drive"] == "reference"
    assert answer["held_out_flights"] == 1
    after, before = answer["after"]["position_rmse_m"], answer["before"]["position_rmse_m"]
    assert after < 0.4 * before
    assert after < 1.5 * answer["noise_floor"]["position_rmse_m"]
