"""`trimtab study paper-controllers`: pieces, resumption, page, pictures and JSON."""

from __future__ import annotations

import json

import pytest

from tests.host.apps.paper.controllers.made_up import pieces
from trimtab.host.apps.paper.controllers.study import FULL, QUICK, WORLDS, plan_pieces
from trimtab.host.cli import main


def test_study_resumes_from_pieces_and_writes_page_pictures_and_json(tmp_path, capsys):
    folder = tmp_path / "study"
    (folder / "pieces").mkdir(parents=True)
    stored = pieces(1, 1)
    wanted = {piece.name for piece in plan_pieces(1, QUICK)}
    assert wanted <= set(stored)
    for name in wanted:
        (folder / "pieces" / f"{name}.json").write_text(json.dumps(stored[name]))
    words = [
        "study",
        "paper-controllers",
        "--quick",
        "--seed",
        "5",
        "-o",
        str(folder),
        "--jobs",
        "1",
        "--json",
    ]
    assert main(words) == 0
    answer = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert answer["best"]["controller"] == "mpc-traced"
    assert answer["error_ratio_baseline"]["median"] == pytest.approx(0.25)
    assert "Selected on tuning courses" in (folder / "report.html").read_text()
    for name in ("dfbc-paper", "mpc-paper", "dfbc-ours"):
        assert (folder / f"{name}.png").stat().st_size > 1000
    assert not (folder / "mpc-ours.png").exists()  # one course has three of the four sets
    words[words.index("5")] = "6"
    assert main(words) == 2
    assert "another seed" in capsys.readouterr().err


def test_plan_pieces_full_study_has_five_worlds_of_four_courses():
    planned = plan_pieces(WORLDS, FULL)
    assert len({piece.name for piece in planned}) == len(planned)
    kinds = [piece.kind for piece in planned]
    numbers = {"select": 3, "full": 5, "balanced": 20, "front": 5, "needs": 4}
    assert {kind: kinds.count(kind) for kind in kinds} == numbers
    assert sum(piece.arguments["courses"] for piece in planned if piece.kind == "front") == 10
