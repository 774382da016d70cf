"""`trimtab study paper-learning`: pieces that leave files, a page, JSON; what it refuses."""

from __future__ import annotations

import json
from typing import Any

import pytest

from trimtab.host.apps.paper.learning import noise, study, summary, transfer
from trimtab.host.apps.paper.learning.study import QUICK, Scope, plan
from trimtab.host.base.pieces import Piece
from trimtab.host.cli import main

full = pytest.mark.full
SMALL = Scope(trials=1, epochs=2, seeds=1, iterations=(4,), scales=(1.0,), noisy=(study.CLOSED.name,))


def made_up_world(ratio: float) -> dict:
    """The piece of a world that nobody flew."""
    error = {"nominal": 0.1, "paper": 0.1 * ratio, "hybrid": 0.09 * ratio, "body": 0.08 * ratio}
    errors = {m: {"position_rmse_m": e, "velocity_rmse_m_s": 2.0 * e} for m, e in error.items()}
    moves = {
        f"{quantity}_{what}": 1.0
        for quantity in ("speed_m_s", "acceleration_m_s2", "jerk_m_s3")
        for what in ("mean", "sd")
    }
    return {
        "world": 0,
        "errors": {name: errors for name in ("train", "test", "ood")},
        "kept": dict.fromkeys(("paper", "hybrid", "body"), "network"),
        "flights": {"train": 13, "test": 3, "ood": 3},
        "failed": [],
        "statistics": {"known": moves, "ood": moves},
    }


def made_up(piece: Piece) -> Any:
    """The result of a piece of the study that nobody computed."""
    norms = {"pointwise_norm": 0.1, "rolled_norm": 0.2, "pointwise_component": 0.1, "rolled_component": 0.1}
    errors = dict.fromkeys(("train", "test", "ood"), norms)
    moved = {"acceleration_rmse": 0.1, "position_rmse_m": 0.1, "nominal_position_rmse_m": 0.2}
    losses = {"train_loss": [2.0, 1.0], "validation_loss": [2.0, 1.5]}
    arguments = {key: value for key, value in piece.arguments.items() if key != "iterations"}
    if piece.kind == "noise":
        methods = (noise.TRAJECTORY, noise.TRAJECTORY_RAW, noise.SUPERVISED, noise.SUPERVISED_RAW)
        return [{**arguments, "method": method, "test": 0.1, "ood": 0.2} for method in methods]
    return {
        "curve": {**arguments, **losses, "seconds": 1.0, "errors": errors},
        "regressor": {**piece.arguments, "seconds": 1.0, "errors": errors},
        "transfer": {
            "steps": [{"step_s": step_s, "position_rmse_m": 0.1} for step_s in transfer.STEPS_S],
            "laws": [{"law": "a", "network": "n", "test": moved, "ood": moved}],
        },
        "world": made_up_world(0.5),
    }[piece.kind]


@pytest.mark.parametrize(
    "computed",
    [
        pytest.param(("nominal",), id="nominal"),
        pytest.param(
            ("nominal", "curve", "regressor-closed-form--mlp", "noise", "transfer"),
            marks=[pytest.mark.long, full],
            id="all-kinds-but-worlds",
        ),
    ],
)
def test_study_goes_on_from_pieces_and_leaves_page_pictures_and_json(tmp_path, monkeypatch, capsys, computed):
    monkeypatch.setattr(study, "QUICK", SMALL)
    folder = tmp_path / "study"
    (folder / "pieces").mkdir(parents=True)
    pieces = plan(5, 1, SMALL)
    assert all(any(piece.name.startswith(name) for piece in pieces) for name in computed)
    for piece in pieces:
        if not piece.name.startswith(computed):
            (folder / "pieces" / f"{piece.name}.json").write_text(json.dumps({"result": made_up(piece)}))
    words = ["study", "paper-learning", "--quick", "--seed", "5", "-o", str(folder), "--jobs", "1", "--json"]
    assert main(words) == 0
    answer = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert answer["flown"]["ratio_median"]["test"]["paper"] == pytest.approx(0.5)
    assert 0.3 < answer["acceleration"]["nominal"]["train"]["pointwise_norm"] < 1.0
    assert {row["step_s"] for row in answer["transfer"]["steps"]} == {0.005, 0.01, 0.02, 0.04}
    page = (folder / "report.html").read_text()
    assert "0.684 / 0.260" in page
    for name in ("curves", "noise", "worlds"):
        assert (folder / f"{name}.png").stat().st_size > 1000
    # Every piece is there: nothing is done twice.
    before = {path: path.stat().st_mtime_ns for path in (folder / "pieces").iterdir()}
    assert main(words) == 0
    assert {path: path.stat().st_mtime_ns for path in (folder / "pieces").iterdir()} == before
    capsys.readouterr()
    words[words.index("5")] = "6"
    assert main(words) == 2
    assert "another seed" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "named"),
    [
        (["paper-learning", "--baselines"], "--baselines"),
        (["blind", "--quick"], "--quick"),
        (["paper-learning", "--worlds", "0"], "--worlds 0"),
    ],
)
def test_study_option_of_another_study_is_refused(tmp_path, capsys, words, named):
    assert main(["study", *words, "-o", str(tmp_path / "s")]) == 2
    assert named in capsys.readouterr().err


def test_plan_full_study_has_what_the_paper_has():
    pieces = plan(1, 5, study.FULL)
    kinds = [piece.kind for piece in pieces]
    assert kinds.count("world") == 5
    assert sum("curve-identity-moving" in piece.name for piece in pieces) == 5
    assert len({piece.name for piece in pieces}) == len(pieces)
    assert len(plan(1, 1, QUICK)) < len(pieces)


def test_text_columns_line_up():
    lines = summary.text([{"a": "1", "b": "x"}, {"a": "222", "b": "y"}])
    assert lines == ["a    b", "1    x", "222  y"]
