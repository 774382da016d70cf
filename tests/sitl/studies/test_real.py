"""The study of real flights: scores against labels, and groups that fail."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import pytest

from trimtab.host.base.errors import UsageError
from trimtab.host.report.studies import REPORTS
from trimtab.host.vehicle import ConfigurationError
from trimtab.sitl.studies.real import run, tables
from trimtab.sitl.studies.recorded import Group, real_row
from trimtab.sitl.studies.scoring.labelled import score_row, summary

DATA = Path(__file__).parents[2] / "data"
WEIGHT = (("mass", "com-offset"),)
STRING = (("slung-payload",), ("mass",))
NORMAL = ((),)


def row(
    verdict: str = "traced", label: str = "x", possible: tuple[str, ...] = (), **named: tuple[str, ...]
) -> dict[str, Any]:
    """A group's row; `named` maps effects, with _ for -, to their aliases."""
    answer = {
        "verdict": verdict,
        "effects": [
            {"name": name.replace("_", "-"), "parameters": {}, "aliases": [{"name": a} for a in aliases]}
            for name, aliases in named.items()
        ],
        "possible": [{"name": name} for name in possible],
    }
    failed = verdict == "failed"
    verdict_file = {
        "answer": {} if failed else answer,
        "exit_code": 2 if failed else 0,
        "errors": "trimtab: too short" if failed else "",
        "trace_s": 1.0,
    }
    return real_row(Group(name="g", logs=("a.mcap",), label=label), verdict_file)


@pytest.mark.parametrize(
    ("answer", "expected", "exact", "exact_names", "in_alias", "false_name"),
    [
        (row(mass=(), com_offset=()), WEIGHT, True, True, True, None),
        (row("undecided", mass=(), com_offset=()), WEIGHT, False, True, True, None),
        (row(mass=("rotor-loss", "com-offset")), WEIGHT, False, False, True, None),
        (row(mass=()), WEIGHT, False, False, False, None),
        (row(mass=(), com_offset=(), wind=()), WEIGHT, False, False, True, None),
        (row(mass=()), STRING, True, True, True, None),
        (row(rotor_loss=("slung-payload",)), STRING, False, False, True, None),
        (row("undecided", possible=("slung-payload",)), STRING, False, False, True, None),
        (row("nothing-missing"), STRING, False, False, False, None),
        (row("failed"), STRING, False, False, False, None),
        (row("nothing-missing"), NORMAL, None, None, None, False),
        (row("undecided", possible=("mass",)), NORMAL, None, None, None, False),
        (row("undecided", mass=()), NORMAL, None, None, None, True),
        (row("failed"), NORMAL, None, None, None, None),
        (row("nothing-missing"), ((), ("mass",)), False, True, False, None),
        (row(mass=()), (), None, None, None, None),
    ],
)
def test_score_of_an_answer_against_the_sets_that_are_right(
    answer: dict[str, Any],
    expected: tuple[tuple[str, ...], ...],
    exact: bool | None,
    exact_names: bool | None,
    in_alias: bool | None,
    false_name: bool | None,
) -> None:
    score = score_row(answer, expected)
    assert score.pop("expected") == [list(names) for names in expected]
    assert score == {
        "exact": exact, "exact_names": exact_names, "in_alias": in_alias, "false_name": false_name
    }  # fmt: skip


def scored() -> list[dict[str, Any]]:
    answers = [
        (row(label="weight", mass=(), com_offset=()), WEIGHT),
        (row(label="weight", rotor_loss=()), WEIGHT),
        (row("failed", label="weight"), WEIGHT),
        (row("undecided", label="string", mass=()), STRING),
        (row("nothing-missing", label="normal"), NORMAL),
        (row("failed", label="normal"), NORMAL),
    ]
    return [{**answer, **score_row(answer, expected)} for answer, expected in answers]


def test_summary_counts_with_exact_intervals_and_a_confusion_by_label() -> None:
    figures = summary(scored())
    assert figures["n"] == {"exact": 4, "exact_names": 4, "in_alias": 4, "false_name": 1, "groups": 6}
    assert (figures["exact"], figures["exact_names"], figures["in_alias"]) == (0.25, 0.5, 0.5)
    assert figures["false_name"] == 0.0
    assert figures["failed"] == 2
    # Clopper and Pearson 1934: 1 of 4 at 95 %, and 0 of 1.
    assert figures["interval"]["exact"] == pytest.approx([0.0063, 0.8059], abs=1e-4)
    assert figures["interval"]["false_name"] == pytest.approx([0.0, 0.975], abs=1e-4)
    assert figures["confusion"] == {
        "weight": {"com-offset + mass": 1, "rotor-loss": 1, "failed": 1},
        "string": {"mass": 1},
        "normal": {"nothing-missing": 1, "failed": 1},
    }


def test_report_shows_shares_confusion_and_every_group() -> None:
    scores = scored()
    figures = summary(scores)
    shown = tables(figures, scores)
    groups = shown["Groups"]
    assert [each["score"] for each in groups] == [
        "exact", "missed", "failed", "exact names, not traced", "right", "failed"
    ]  # fmt: skip
    assert groups[2]["answer"] == "trimtab: too short"
    outcome = {"answer": {"study": "real", **figures, "groups": scores}, "tables": shown}
    page = REPORTS["real"].page(outcome, {}, {})
    assert "Real flights: 6 groups" in page
    assert "0.6-80.6 %" in page
    assert page.count("com-offset + mass") >= 1


def test_study_needs_a_file_and_effects_that_exist(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=r"trimtab study real FLIGHTS\.toml"):
        run(folder=tmp_path / "state", seed=1, vehicle="nano", jobs=1)
    shutil.copy(DATA / "a1.mcap", tmp_path)
    file = tmp_path / "flights.toml"
    file.write_text('[[group]]\nname = "x"\nlabel = "x"\nlogs = ["a1.mcap"]\nexpected = [["weight"]]\n')
    with pytest.raises(ConfigurationError, match=r"x: expected: no effect called weight; known: .*mass"):
        run(folder=tmp_path / "state", seed=1, vehicle="nano", jobs=1, flights=file)
    assert not (tmp_path / "state").exists()


def test_group_that_cannot_be_imported_or_traced_is_reported(tmp_path: Path) -> None:
    (tmp_path / "log00").write_bytes(b"\xbc no log")
    (tmp_path / "f.mcap").write_bytes(b"no log")
    file = tmp_path / "flights.toml"
    file.write_text(
        '[[group]]\nname = "usd"\nlogs = ["log00"]\nformat = "crazyflie-usd"\nvehicle = "nano"\n'
        'label = "cut"\nexpected = [["rotor-loss"]]\n'
        '[[group]]\nname = "own"\nlogs = ["f.mcap"]\n'
    )
    done: list[tuple[float, float, str]] = []
    state = tmp_path / "state"
    outcome = run(
        folder=state,
        seed=1,
        vehicle="nano",
        jobs=1,
        flights=file,
        on_progress=lambda *args: done.append(args),
    )
    usd, own = outcome["answer"]["groups"]
    assert (usd["verdict"], own["verdict"]) == ("failed", "failed")
    assert "log00" in usd["errors"]
    assert "f.mcap" in own["errors"]
    assert outcome["answer"]["failed"] == 2
    assert outcome["answer"]["exact"] == 0.0
    assert outcome["answer"]["confusion"] == {"cut": {"failed": 1}}
    assert any("log00" in line for line in outcome["lines"])
    assert done == [(0.0, 2.0, ""), (1.0, 2.0, "usd: failed"), (2.0, 2.0, "own: failed")]
    assert (state / "real" / "00" / "verdict.json").is_file()
