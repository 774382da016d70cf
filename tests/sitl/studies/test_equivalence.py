"""The comparison of two commits' records: what counts as a difference, and what regrouping explains."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from trimtab.sitl.studies.equivalence.compare import Difference, Kind, compare
from trimtab.sitl.studies.equivalence.freeze import log_digest

LOG = Path(__file__).parents[2] / "data" / "a1.mcap"

RECORD = {
    "exit_code": 0,
    "answer": {
        "verdict": "traced",
        "seconds": 3.0,
        "effects": [{"name": "wind", "parameters": {"north": {"value": 1.0, "sd": 0.1}}}],
        "reasons": ["fly it twice"],
        "after": {"position_rmse_m": 0.004},
    },
    "reference": {"id": "abc", "nodes": [[0, 1.0, 2.0]]},
}


def differences(tmp_path: Path, change: dict[str, Any], *, regrouped: bool = False) -> list[Difference]:
    """Return what differs between RECORD and RECORD with the values of `change`, by dotted path."""
    changed = json.loads(json.dumps(RECORD))
    for path, value in change.items():
        at: Any = changed
        *parents, last = path.split(".")
        for key in parents:
            at = at[int(key)] if isinstance(at, list) else at[key]
        at[int(last) if isinstance(at, list) else last] = value
    for name, record in (("before", RECORD), ("after", changed)):
        folder = tmp_path / name / "worlds"
        folder.mkdir(parents=True)
        (folder / "one.json").write_text(json.dumps(record), encoding="utf-8")
    counts, found = compare(tmp_path / "before", tmp_path / "after", regrouped=regrouped)
    assert counts == {"worlds": 1}
    return found


def test_equal_records_have_no_difference(tmp_path: Path) -> None:
    assert differences(tmp_path, {}) == []


def test_time_taken_is_no_difference(tmp_path: Path) -> None:
    assert differences(tmp_path, {"answer.seconds": 9.0}) == []


def test_added_key_is_no_difference(tmp_path: Path) -> None:
    assert differences(tmp_path, {"answer.findings": []}) == []


@pytest.mark.parametrize(
    ("path", "value", "kind"),
    [
        ("answer.verdict", "undecided", Kind.VALUE),
        ("exit_code", 2, Kind.NUMBER),
        ("answer.effects", [], Kind.VALUE),
        ("answer.effects.0.parameters.north.value", 1.0 + 1e-15, Kind.NUMBER),
        ("answer.reasons.0", "fly it three times", Kind.WORDS),
        ("reference.nodes.0.1", 1.0 + 1e-12, Kind.NUMBER),
    ],
)
def test_changed_value_is_a_difference(tmp_path: Path, path: str, value: Any, kind: Kind) -> None:
    (found,) = differences(tmp_path, {path: value})
    assert found.kind is kind


def test_missing_record_is_a_difference(tmp_path: Path) -> None:
    (tmp_path / "before" / "plans").mkdir(parents=True)
    (tmp_path / "before" / "plans" / "a.json").write_text("{}", encoding="utf-8")
    (tmp_path / "after").mkdir()
    _, (found,) = compare(tmp_path / "before", tmp_path / "after", regrouped=True)
    assert found.kind is Kind.MISSING


@pytest.mark.parametrize(
    ("path", "value", "close"),
    [
        ("answer.effects.0.parameters.north.value", 1.0009, True),
        ("answer.effects.0.parameters.north.value", 1.0011, False),
        ("reference.nodes.0.1", 1.00009, True),
        ("reference.nodes.0.1", 1.0002, False),
        ("reference.id", "def", True),
        ("answer.after.position_rmse_m", 0.00401, True),
        ("answer.after.position_rmse_m", 0.0043, False),
        ("answer.verdict", "undecided", False),
    ],
)
def test_regrouped_arithmetic_explains_small_differences_only(
    tmp_path: Path, path: str, value: Any, close: bool
) -> None:
    assert (differences(tmp_path, {path: value}, regrouped=True) == []) is close


def test_log_digest_covers_topics_and_leaves_the_commit_out() -> None:
    digest = log_digest(LOG)
    assert {"/mocap/pose", "/fc/control", "/fc/estimate"} <= digest.keys()
    assert not any('"git"' in value or '"version"' in value for value in digest.values())
