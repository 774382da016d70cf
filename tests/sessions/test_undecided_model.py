"""A model of an undecided verdict is used only if that is accepted, by every verb that takes a model."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from trimtab.host.models.file import read_model, write_model
from trimtab.host.models.model import Assessment
from trimtab.protocol.blobs import Reference

MADE = Path(__file__).parents[1] / "data"
Run = Callable[..., tuple[int, dict[str, Any], str]]
UNDECIDED = Assessment(
    verdict="undecided", probabilities={"linear-drag": 0.6}, held_out_flights=1, before_m=0.05, after_m=0.02
)
STATED = "m.model.toml: its verdict is undecided (linear-drag 0.60; held out 50.0 to 20.0 mm)"
WORDS = {
    "plan": ("plan", "figure-eight", "--kind", "min-snap", "-o", "out.ref"),
    "fly": ("fly", "eight.ref", "--controller", "mpc-neural", "-o", "out.mcap"),
    "learn": ("learn", "eight-0.mcap", "-o", "out.model.toml"),
    "correct": ("correct", "m.model.toml", "-o", "out.ff"),
    "predict": ("predict", "m.model.toml", str(MADE / "a1.mcap")),
}


@pytest.fixture
def model(drag_model: str, reference: Reference, tmp_path: Path) -> Callable[[Assessment | None], None]:
    """Writes m.model.toml with an assessment, beside eight.ref."""
    (tmp_path / "eight.ref").write_bytes(reference.to_bytes())

    def write(assessment: Assessment | None) -> None:
        content = replace(read_model(tmp_path / drag_model), assessment=assessment)
        write_model(content, tmp_path / "m.model.toml", force=True)

    return write


def words_of(verb: str) -> tuple[str, ...]:
    return WORDS[verb] if verb in ("correct", "predict") else (*WORDS[verb], "--model", "m.model.toml")


@pytest.mark.parametrize("verb", ["plan", "fly", "correct", "predict"])
def test_undecided_model_is_refused_in_one_line_unless_accepted(
    verb: str, model: Any, run_trimtab: Run, tmp_path: Path
) -> None:
    model(UNDECIDED)
    before = set(tmp_path.iterdir())
    code, told, complaint = run_trimtab(*words_of(verb), "--json")
    assert (code, told["exit_code"]) == (2, 2)
    assert complaint.count("\n") == 1
    assert STATED in complaint
    assert "--accept-undecided" in complaint
    assert set(tmp_path.iterdir()) == before
    code, told, complaint = run_trimtab(*words_of(verb), "--accept-undecided", "--json")
    assert code == 0
    assert [line for line in complaint.splitlines() if "undecided" in line] == [
        f"trimtab: {STATED}; accepted"
    ]
    assert "error" not in told


def test_learn_on_an_undecided_model_is_refused_unless_accepted(model: Any, run_trimtab: Run) -> None:
    model(UNDECIDED)
    assert run_trimtab("fly", "eight.ref")[0] == 0
    code, _, complaint = run_trimtab(*words_of("learn"))
    assert code == 2
    assert STATED in complaint
    _, _, complaint = run_trimtab(*words_of("learn"), "--accept-undecided")
    assert f"{STATED}; accepted" in complaint  # and then the flight is too short to learn from


@pytest.mark.parametrize(
    ("assessment", "verdict", "part"),
    [
        (Assessment(verdict="traced"), "traced", ""),
        (Assessment(verdict="outside-library"), "outside-library", "a cause outside the library"),
        (None, None, "states no verdict"),
    ],
)
def test_other_models_are_used_and_what_limits_them_is_told(
    assessment: Assessment | None, verdict: str | None, part: str, model: Any, run_trimtab: Run
) -> None:
    model(assessment)
    code, told, complaint = run_trimtab(*words_of("plan"), "--json")
    assert (code, told["model_verdict"]) == (0, verdict)
    assert part in complaint
    assert complaint.count("\n") == (1 if part else 0)
