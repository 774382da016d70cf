"""References on disk and the verb: both files or none, the same bytes, one line for what is wrong."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest

from trimtab.host.base.errors import UsageError
from trimtab.host.cli import main
from trimtab.host.link.blob_files import model_of, read_reference
from trimtab.host.models.file import write_model
from trimtab.host.models.model import Model
from trimtab.host.plan import plan, write_plan
from trimtab.host.route import load_route
from trimtab.host.vehicle import load_vehicle

VEHICLE = load_vehicle("research")
ROUTE = """
name = "hop"
total_time_s = 3.0
waypoints_m = [[0.0, 0.0, -1.0], [1.5, 0.5, -1.4], [3.0, 0.0, -1.0]]
"""


@pytest.fixture
def workspace(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty workspace with one route, as the current folder."""
    (tmp_path / "routes").mkdir()
    (tmp_path / "routes" / "hop.toml").write_text(ROUTE)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def _answer(capsys: pytest.CaptureFixture[str]) -> dict:
    return json.loads(capsys.readouterr().out.splitlines()[-1])


def _drag(folder: Path) -> Model:
    model = Model(
        vehicle_id=VEHICLE.id,
        vehicle_name=VEHICLE.name,
        effects={"linear-drag": {"dx": 0.5, "dy": 0.4, "dz": 0.1}},
    )
    write_model(model, folder / "found.model.toml")
    return model


def test_written_plan_reads_back_with_its_provenance(tmp_path: Path) -> None:
    made = plan(load_route("pretzel"), VEHICLE)
    provenance = {"version": "1", "git": None, "command": "x", "seed": None, "parents": {"model": "0" * 12}}
    path = write_plan(made, tmp_path / "a.ref", provenance=provenance)
    assert read_reference(path) == made.reference
    assert model_of(path) == "0" * 12
    told = json.loads((tmp_path / "a.ref.json").read_text())
    assert told["reference"] == made.reference.id
    assert told["plan"]["margins"] == dict(made.margins)
    assert "solve_s" not in told["plan"]


def test_written_plan_twice_is_the_same_bytes(tmp_path: Path) -> None:
    for name in ("a", "b"):
        write_plan(plan(load_route("pretzel"), VEHICLE), tmp_path / f"{name}.ref")
    assert (tmp_path / "a.ref").read_bytes() == (tmp_path / "b.ref").read_bytes()
    assert (tmp_path / "a.ref.json").read_bytes() == (tmp_path / "b.ref.json").read_bytes()


def test_written_plan_never_overwrites_unasked(tmp_path: Path) -> None:
    made = plan(load_route("pretzel"), VEHICLE)
    write_plan(made, tmp_path / "a.ref")
    (tmp_path / "a.ref").unlink()
    with pytest.raises(UsageError, match=r"a\.ref\.json: exists"):
        write_plan(made, tmp_path / "a.ref")
    assert not (tmp_path / "a.ref").exists()
    write_plan(made, tmp_path / "a.ref", force=True)
    with pytest.raises(UsageError, match=r"ends in \.ref"):
        write_plan(made, tmp_path / "a.mcap")


def test_verb_without_a_model_plans_min_snap(workspace: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["plan", "hop", "--json"]) == 0
    answer = _answer(capsys)
    assert answer["reference"] == "hop.ref"
    assert answer["id"] == read_reference(workspace / "hop.ref").id
    assert (answer["kind"], answer["status"]) == ("min-snap", "solved")
    assert answer["duration_s"] == pytest.approx(3.0)
    assert answer["residual_rms_m_s2"] is None
    assert set(answer) >= {"margins", "solve_s", "iterations"}
    assert main(["plan", "hop"]) == 2
    assert "exists" in capsys.readouterr().err


def test_verb_with_a_model_of_drag_plans_min_residual(
    workspace: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    model = _drag(workspace)
    words = ["plan", "hop", "--model", "found.model.toml", "--headroom", "0.1", "0.6", "--nodes", "50"]
    assert main([*words, "-o", "new.ref", "--json"]) == 0
    answer = _answer(capsys)
    assert answer["kind"] == "min-residual"
    assert answer["residual_rms_m_s2"] > 0.0
    assert answer["iterations"] > 0
    assert answer["margins"]["thrust_low"] >= 0.0
    assert model_of(workspace / "new.ref") == model.id
    assert main([*words, "-o", "star.ref", "--kind", "min-control*", "--json"]) == 0
    assert _answer(capsys)["augmented"] is True


@pytest.mark.parametrize(
    ("words", "code", "said"),
    [
        (["nowhere"], 2, "no such route"),
        (["hop", "--kind", "min-time"], 2, "no such kind"),
        (["hop", "--kind", "min-residual"], 2, "needs a model"),
        (["hop", "--time-s", "0.2"], 2, "routes/hop.toml: total_time_s: "),
        (["hop", "--time-s", "1.0"], 1, "node"),
        (["hop", "--time-s", "1e9"], 2, "--time-s 1e+09: give a time above 0 and at most 500 s"),
        (["hop", "--headroom", "0.9", "0.1"], 2, "--headroom 0.9 0.1: give two shares"),
        (["hop", "--headroom", "nan", "nan"], 2, "--headroom nan nan: give two shares"),
        (
            ["hop", "--headroom", "0.3", "0.6"],
            2,
            "--headroom: limits.thrust_headroom: [0.3, 0.6] is without hover",
        ),
        (["hop", "--headroom", "0.1", "0.2"], 2, "is without hover, 0.217; take that in"),
        (["hop", "--headroom", "0.0", "0.9"], 2, "--headroom: limits.thrust_headroom: [0.0, 0.9] leaves"),
        (["hop", "--model", "missing.model.toml"], 2, "cannot be read"),
        (["hop", "-o", "hop.txt"], 2, "ends in .ref"),
        (["hop", "--nodes", "3", "--kind", "min-control"], 2, "nodes"),
    ],
)
def test_verb_of_bad_input_says_one_line_and_leaves_nothing(
    workspace: Path, capsys: pytest.CaptureFixture[str], words: list[str], code: int, said: str
) -> None:
    assert main(["plan", *words]) == code
    lines = capsys.readouterr().err.strip().splitlines()
    assert len(lines) == 1
    assert said in lines[0]
    shutil.rmtree(workspace / "routes")
    assert list(workspace.iterdir()) == []
