"""`trimtab predict` and `trimtab compare` on the command line: answers, refusals and exit codes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from trimtab.host import cli
from trimtab.host.models.file import read_model, write_model

MADE = Path(__file__).parents[1] / "data"
A1, B1 = str(MADE / "a1.mcap"), str(MADE / "b1.mcap")
Run = Callable[..., tuple[int, dict[str, Any], str]]


def test_predict_prints_each_flight_and_the_difference(
    drag_model: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert cli.main(["predict", drag_model, A1, B1]) == 0
    told = capsys.readouterr()
    first, *flights, whole, median, difference, better = told.out.splitlines()
    assert first == "drag.model.toml: position error of predictions, whole flights from their references"
    assert [line.split("  ")[1] for line in flights] == [A1, B1]
    assert whole.startswith("RMSE of all flights: ")
    assert median.startswith("median of the flights: ")
    assert "95 % interval" in difference  # the flights lack no drag: the model is worse
    assert better == "better than the nominal model on 0 of 2"
    assert told.err == ""
    assert cli.main(["predict", "nominal", A1]) == 0
    assert "difference" not in capsys.readouterr().out


def test_predict_with_a_diverging_model_is_an_answer(drag_model: str, run_trimtab: Run) -> None:
    wrong = {"linear-drag": {"dx": -40.0, "dy": -35.0, "dz": -20.0}}
    write_model(replace(read_model(drag_model), effects=wrong), "wrong.model.toml")
    code, told, _ = run_trimtab("predict", "wrong.model.toml", A1, "--json")
    assert code == 0
    assert told["diverged"] == [A1]
    assert told["model"]["position_rmse_m"] is None
    assert told["nominal"]["position_rmse_m"] > 0.0


@pytest.mark.parametrize(
    ("words", "code", "part"),
    [
        (("predict", "drag.model.toml"), 2, "no log given"),
        (("predict", "missing.model.toml", A1), 2, "missing.model.toml: cannot be read"),
        (("predict", "other.model.toml", A1), 2, "other.model.toml: is of vehicle other"),
        (("predict", "ghost.model.toml", A1), 2, "names ghost, which is no known effect"),
        (("predict", "drag.model.toml", A1, A1), 2, "the same flight as"),
        (("predict", "drag.model.toml", "cut.mcap"), 5, "cut.mcap: ends early or is damaged"),
        (("predict", "drag.model.toml", "none.mcap"), 2, "none.mcap: cannot be read"),
        (("compare", "drag.model.toml", A1), 2, "compare two of the same kind"),
        (("compare", A1, "cut.mcap"), 5, "cut.mcap: ends early or is damaged"),
        (("compare", A1, "none.mcap"), 2, "none.mcap: cannot be read"),
        (("compare", A1, "none"), 2, "none: no such file or folder"),
        (("compare", "drag.model.toml", "other.model.toml"), 2, "compare models of one vehicle"),
        (("compare", "drag.model.toml", "bad.model.toml"), 2, "bad.model.toml"),
    ],
)
def test_what_cannot_be_used_is_refused_in_one_line(
    words: tuple[str, ...], code: int, part: str, drag_model: str, run_trimtab: Run, tmp_path: Path
) -> None:
    drag = read_model(drag_model)
    write_model(replace(drag, vehicle_id="0" * 12, vehicle_name="other"), "other.model.toml")
    write_model(replace(drag, effects={"ghost": {"k": 1.0}}), "ghost.model.toml")
    Path("bad.model.toml").write_text(Path(drag_model).read_text().replace("dx", "dy", 1))
    Path("cut.mcap").write_bytes(Path(A1).read_bytes()[:100_000])
    before = {path.name for path in tmp_path.iterdir()}
    found, told, complaint = run_trimtab(*words, "--json")
    assert (found, told["exit_code"]) == (code, code)
    assert part in complaint
    assert complaint.count("\n") == 1
    assert {path.name for path in tmp_path.iterdir()} == before


def test_same_inputs_give_the_same_answer(drag_model: str, run_trimtab: Run) -> None:
    for words in (("predict", drag_model, A1), ("compare", A1, B1)):
        assert run_trimtab(*words, "--json")[1] == run_trimtab(*words, "--json")[1]
