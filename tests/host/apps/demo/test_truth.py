"""What a demo says of its verdict once it may open the truth."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from trimtab.host.apps.demo.files import JSON_NAME
from trimtab.host.apps.demo.truth import Judgement, judge, judgement_words, open_truth
from trimtab.host.effects import load_effects
from trimtab.host.link.simulated import TRUTH_SUFFIX
from trimtab.host.report.truth import page

EFFECTS = load_effects()
DRAG = {"dx": 0.3, "dy": 0.4, "dz": 0.2}


def judged(verdict: str, named: dict[str, dict[str, float]], true: dict[str, dict[str, float]]) -> Judgement:
    """The judgement of a verdict whose values have a standard deviation of 0.1."""
    effects = [
        {"name": name, "parameters": {key: {"value": value, "sd": 0.1} for key, value in values.items()}}
        for name, values in named.items()
    ]
    return judge({"verdict": verdict, "effects": effects}, true, EFFECTS)


@pytest.mark.parametrize(
    ("verdict", "named", "true", "right", "sets"),
    [
        ("traced", ["motor-lag"], ["motor-lag"], True, (["motor-lag"], [], [])),
        ("traced", ["motor-lag"], ["motor-lag", "wind"], False, (["motor-lag"], ["wind"], [])),
        ("traced", ["motor-lag", "wind"], ["motor-lag"], False, (["motor-lag"], [], ["wind"])),
        ("undecided", [], ["wind"], False, ([], ["wind"], [])),
        ("nothing-missing", [], [], True, ([], [], [])),
        ("traced", ["wind"], [], False, ([], [], ["wind"])),
        ("outside-library", [], ["tether"], True, ([], ["tether"], [])),
        ("traced", ["wind"], ["tether"], False, ([], ["tether"], ["wind"])),
        # No flight distinguishes mass from thrust gain; beside one of them an inertia states nothing more.
        ("traced", ["thrust-gain"], ["mass"], True, (["mass"], [], [])),
        ("traced", ["mass", "inertia"], ["thrust-gain"], True, (["thrust-gain"], [], [])),
        ("traced", ["inertia"], ["wind"], False, ([], ["wind"], ["inertia"])),
    ],
)
def test_judgement_tells_found_missed_and_invented(
    verdict: str, named: list[str], true: list[str], right: bool, sets: tuple[list[str], ...]
) -> None:
    judgement = judged(verdict, {name: {} for name in named}, {name: {} for name in true})
    assert judgement.is_right is right
    assert (judgement.found, judgement.missed, judgement.invented) == tuple(map(tuple, sets))
    assert judgement_words(judgement).startswith("The verdict is right") is right


def test_rows_hold_the_error_in_standard_deviations_and_what_is_not_known() -> None:
    judgement = judged(
        "traced", {"linear-drag": {**DRAG, "dx": 0.45}, "wind": {"wx": 1.0}}, {"linear-drag": DRAG}
    )
    sigmas = {(row.effect, row.key): row.sigmas for row in judgement.rows}
    assert sigmas == {
        ("linear-drag", "dx"): pytest.approx(1.5),
        ("linear-drag", "dy"): 0.0,
        ("linear-drag", "dz"): 0.0,
        ("wind", "wx"): None,
    }
    truth: dict[str, Any] = {
        "world": "w",
        "deviations": {},
        "turbulence": {"force_m_s2": 0.1, "torque_rad_s2": 0.2},
    }
    html = page(judgement, truth, "abc", None, None)
    for text in ("invented", ">1.5<", "not in the world", "demo.json, id abc"):
        assert text in html
    assert not any(word in html for word in ("http://", "https://", "<script"))


def test_truth_stays_sealed_until_the_verdict_is_a_file(tmp_path: Path) -> None:
    (tmp_path / f"a.mcap{TRUTH_SUFFIX}").write_text(json.dumps({"log": "aa", "effects": {}}))
    with pytest.raises(ValueError, match="sealed until"):
        open_truth(tmp_path, "a.mcap", "aa")
    (tmp_path / JSON_NAME).write_text("{}")
    assert open_truth(tmp_path, "a.mcap", "aa")["effects"] == {}
    with pytest.raises(ValueError, match="of log aa, not bb"):
        open_truth(tmp_path, "a.mcap", "bb")
