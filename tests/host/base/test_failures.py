"""Too little memory and singular matrices: one line and exit code 2, never "a bug"."""

from __future__ import annotations

import errno
import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from trimtab.host.base.failures import ADDRESS_SPACE_MIN_MB, failure_message
from trimtab.host.models.file import write_model
from trimtab.host.models.model import Model
from trimtab.host.vehicle import load_vehicle

resource = pytest.importorskip("resource", reason="no limits of memory here")
DATA = Path(__file__).parents[2] / "data"
LOGS = tuple(str(DATA / f"{name}.mcap") for name in ("a1", "b1"))
PLAN = ("plan", "figure-eight", "--kind", "min-control-r", "--model", "drag.model.toml", "--nodes", "1600")
VERBS = {
    "plan": (*PLAN, "-o", "p.ref"),
    "learn": ("learn", *LOGS, "--epochs", "2", "--hidden", "4", "-o", "m.model.toml"),
    "trace": ("trace", LOGS[0]),
}


@pytest.fixture
def run_limited(tmp_path: Path) -> Callable[..., tuple[int, str, dict[str, object]]]:
    """Runs a verb of VERBS with so many MB of address space: exit code, stderr, the JSON object."""
    vehicle = load_vehicle("research")
    drag = {"linear-drag": {"dx": 0.4, "dy": 0.35, "dz": 0.2}}
    model = Model(vehicle_id=vehicle.id, vehicle_name=vehicle.name, effects=drag)
    write_model(model, tmp_path / "drag.model.toml")

    def run(verb: str, limit_mb: int) -> tuple[int, str, dict[str, object]]:
        size = limit_mb * 2**20
        done = subprocess.run(
            [sys.executable, "-m", "trimtab.host.cli", *VERBS[verb], "--json"],
            capture_output=True,
            text=True,
            check=False,
            cwd=tmp_path,
            preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_AS, (size, size)),
        )
        return done.returncode, done.stderr, json.loads(done.stdout.splitlines()[-1])

    return run


@pytest.mark.parametrize("verb", VERBS)
def test_address_space_below_the_least_is_one_line(
    run_limited: Callable[..., tuple[int, str, dict[str, object]]], verb: str
) -> None:
    code, complaint, answer = run_limited(verb, 256)
    assert code == 2
    (line,) = complaint.splitlines()
    assert "limited to 256 MB" in line
    assert f"`ulimit -v {ADDRESS_SPACE_MIN_MB * 1024}`" in line
    assert answer == {"error": line.removeprefix("trimtab: "), "exit_code": 2}


@pytest.mark.parametrize(
    ("verb", "limit_mb"), [("learn", 512), ("trace", 512), ("plan", 512), ("plan", 600), ("plan", 1024)]
)
def test_little_address_space_is_a_result_or_one_line(
    run_limited: Callable[..., tuple[int, str, dict[str, object]]], verb: str, limit_mb: int
) -> None:
    code, complaint, answer = run_limited(verb, limit_mb)
    if code == 0:
        assert "error" not in answer
        return
    assert code == 2
    (line,) = complaint.splitlines()
    assert line.startswith("trimtab: out of memory")
    assert answer["exit_code"] == 2


def test_failure_message_names_the_remedy_of_the_verb() -> None:
    assert "trace fewer logs" in str(failure_message(MemoryError(), "trace"))
    assert "plan with fewer --nodes" in str(failure_message(MemoryError(), "plan"))
    assert "(9 MiB)" in str(failure_message(MemoryError("9 MiB"), "demo"))
    assert "out of memory" in str(failure_message(OSError(errno.ENOMEM, "Cannot allocate memory"), "fly"))
    singular = np.linalg.LinAlgError("Singular matrix")
    for verb in ("trace", "learn", "plan"):
        assert "do not determine" in str(failure_message(singular, verb))
    assert failure_message(singular, "fly") is None
    assert failure_message(KeyError("lost"), "trace") is None
