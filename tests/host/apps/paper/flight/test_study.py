"""`trimtab study paper-flight`: pieces that leave files, a page, pictures, JSON; what it refuses."""

from __future__ import annotations

import json

import pytest

from tests.host.apps.paper.flight.made_up import made_up_world
from trimtab.host.apps.paper.flight.study import PRETZELS, QUICK_PRETZELS, WORLDS, plan_pieces
from trimtab.host.cli import main


def test_study_resumes_from_pieces_and_writes_page_pictures_and_json(tmp_path, capsys):
    folder = tmp_path / "study"
    (folder / "pieces").mkdir(parents=True)
    (folder / "pieces" / "world-00.json").write_text(json.dumps({"result": made_up_world()}))
    words = ["study", "paper-flight", "--quick", "--seed", "5", "-o", str(folder), "--jobs", "1", "--json"]
    assert main(words) == 0
    answer = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert answer["prediction_ratio"] == pytest.approx({"train": 0.25, "test": 0.25, "ood": 0.25})
    assert answer["tables"]["Table III: the pretzel"][4]["paper, min-residual"] == "0.098"
    page = (folder / "report.html").read_text()
    assert page.index("Worse than in the paper") < page.index("Table I:")
    for name in (
        "prediction",
        "controllers-flights",
        "controllers-ahead",
        "controllers-ahead-same-torque",
        "pretzel-errors",
        "pretzel",
    ):
        assert (folder / f"{name}.png").stat().st_size > 1000
    record = json.loads((folder / "report.json").read_text())
    assert record["provenance"]["seed"] == 5
    assert record["scores"]["world-00"]["result"]["network"] is True
    words[words.index("5")] = "6"
    assert main(words) == 2
    assert "another seed" in capsys.readouterr().err


def test_study_pretzel_without_flights_has_no_picture_of_it(tmp_path, capsys):
    folder = tmp_path / "study"
    (folder / "pieces").mkdir(parents=True)
    world = {**made_up_world(), "pretzel": {"plans": {}, "flights": [], "failed": "no path"}}
    (folder / "pieces" / "world-00.json").write_text(json.dumps({"result": world}))
    assert main(["study", "paper-flight", "--quick", "--seed", "5", "-o", str(folder), "--json"]) == 0
    assert json.loads(capsys.readouterr().out.splitlines()[-1])["failed"][0]["why"] == "no path"
    assert not (folder / "pretzel.png").exists()


def test_plan_pieces_full_study_has_five_worlds():
    pieces = plan_pieces(WORLDS, PRETZELS, 40)
    assert [piece.arguments["world"] for piece in pieces] == [0, 1, 2, 3, 4]
    assert len({piece.name for piece in pieces}) == 5
    assert all(piece.arguments["pretzels"] > QUICK_PRETZELS for piece in pieces)
