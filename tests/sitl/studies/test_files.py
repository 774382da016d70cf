"""The seal: a hash recorded once, a truth that is opened only beside a verdict and only unchanged."""

from __future__ import annotations

from pathlib import Path

import pytest

from trimtab.sitl.studies.files import Ledger, SealBroken, StudyError, read_json, sha256_of, write_json
from trimtab.sitl.studies.flights import TRUTH, VERDICT
from trimtab.sitl.studies.scoring.world import open_truth


@pytest.fixture
def world(tmp_path: Path) -> Path:
    folder = tmp_path / "0007"
    folder.mkdir()
    write_json(folder / TRUTH, {"kinds": ["mass"]})
    return folder


def test_truth_stays_sealed_until_there_is_a_verdict(world: Path, tmp_path: Path) -> None:
    ledger = Ledger(tmp_path / "ledger.json")
    ledger.record("0007", sha256_of(world / TRUTH))
    with pytest.raises(StudyError, match="sealed until"):
        open_truth(world, ledger)
    write_json(world / VERDICT, {})
    assert open_truth(world, ledger) == {"kinds": ["mass"]}


def test_changed_truth_is_refused(world: Path, tmp_path: Path) -> None:
    ledger = Ledger(tmp_path / "ledger.json")
    ledger.record("0007", sha256_of(world / TRUTH))
    write_json(world / VERDICT, {})
    write_json(world / TRUTH, {"kinds": ["wind"]})
    with pytest.raises(SealBroken, match="not the one that was sealed"):
        open_truth(world, Ledger(tmp_path / "ledger.json"))


def test_truth_that_was_never_recorded_is_refused(world: Path, tmp_path: Path) -> None:
    write_json(world / VERDICT, {})
    with pytest.raises(SealBroken, match="no hash"):
        open_truth(world, Ledger(tmp_path / "ledger.json"))


def test_recorded_hash_never_changes(tmp_path: Path) -> None:
    Ledger(tmp_path / "ledger.json").record("0001", "a" * 64)
    again = Ledger(tmp_path / "ledger.json")
    again.record("0001", "a" * 64)
    with pytest.raises(SealBroken):
        again.record("0001", "b" * 64)
    assert read_json(tmp_path / "ledger.json") == {"0001": "a" * 64}


def test_file_that_cannot_be_written_leaves_the_old_one(tmp_path: Path) -> None:
    write_json(tmp_path / "x.json", {"n": 1.0})
    with pytest.raises(ValueError, match="JSON"):
        write_json(tmp_path / "x.json", {"n": float("nan")})
    assert read_json(tmp_path / "x.json") == {"n": 1.0}
