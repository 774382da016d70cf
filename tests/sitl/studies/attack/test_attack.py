"""The study of attacks: forgeries are refused, weakened verifiers are caught, answers can be bad."""

from __future__ import annotations

from pathlib import Path
from random import Random
from typing import Any

import pytest

from tests.sitl.studies.attack.made_up import made_up_rows
from trimtab.protocol.signing import SIMULATED_EPOCH, Verdict, Verifier
from trimtab.sitl.studies.attack import frames
from trimtab.sitl.studies.attack.mutants import MUTANTS
from trimtab.sitl.studies.attack.ports import FILES, climb, climbing_path
from trimtab.sitl.studies.attack.study import run, summary


@pytest.mark.parametrize("kind", frames.KINDS)
def test_frames_with_one_field_wrong_or_sent_again_are_refused_and_lock_nobody_out(kind: str) -> None:
    found = frames.attack(kind, 1000, seed=3)
    assert found.trials >= 1000
    assert (found.accepted, found.lockouts) == (0, 0)


@pytest.mark.parametrize("kind", frames.TAMPERED)
def test_forged_frames_are_valid_in_form_and_differ_from_the_genuine_ones(kind: str) -> None:
    link = frames.Link(Random(3), Verifier(frames.KEY, epoch=SIMULATED_EPOCH))
    sent, frame = link.genuine()
    forged = frames.TAMPERED[kind](link, sent, frame)
    assert forged != frame
    link.vehicle.verifier = None
    assert link.accepts(forged)  # a vehicle without a key handles it


@pytest.mark.parametrize("mutant", MUTANTS)
def test_weakened_verifier_is_caught(mutant: str) -> None:
    found = [frames.attack(kind, 1000, 3, MUTANTS[mutant]) for kind in frames.KINDS]
    assert any(count.accepted or count.lockouts for count in found)


def test_weakened_verifiers_accept_what_is_genuine() -> None:
    for make in MUTANTS.values():
        link = frames.Link(Random(3), make(frames.KEY, epoch=SIMULATED_EPOCH))
        assert all(link.accepts(link.genuine()[1]) for _ in range(100))
        assert link.verifier.counts[Verdict.ACCEPTED] == 100


def test_no_climbing_path_opens_a_file() -> None:
    found = climb(300, seed=3)
    assert found["paths"] >= 300
    assert found["opened"] == []
    rng = Random(3)
    assert any(climbing_path(rng).removeprefix("/") in FILES for _ in range(5000))  # some do exist


@pytest.mark.parametrize(
    ("changes", "takeovers", "misreported", "crashes"),
    [
        ({}, 0, 0, 0),
        ({"changed": True, "takeover": "hold"}, 1, 0, 0),
        ({"changed": True, "misreported": True, "departed_m": 1.0}, 1, 1, 0),
        ({"changed": True, "crashed": True}, 1, 0, 1),
        ({"changed": True, "crashed": True, "kind": "terminate"}, 0, 0, 0),  # OWN_OTHERS allows it
        ({"changed": True, "crashed": True, "kind": "terminate", "signed": True}, 1, 0, 1),
        ({"changed": True, "takeover": "hold", "address": "owner"}, 0, 0, 0),  # a false sender
        ({"changed": True, "takeover": "hold", "address": "owner", "signed": True}, 1, 0, 0),
    ],
)
def test_answer_counts_what_a_stranger_changed(
    changes: dict[str, Any], takeovers: int, misreported: int, crashes: int
) -> None:
    answer = summary({"seed": 1, "quick": True, "folder": "."}, made_up_rows(**changes))["answer"]
    counted = (answer["takeovers"], answer["misreported"], answer["crashes"])
    assert counted == (takeovers, misreported, crashes)
    assert (answer["mutants_caught"], answer["mutants"]) == (1, 1)
    assert answer["flood_ratio_max"] == pytest.approx(1.1)


def test_flood_that_ended_a_flight_gives_no_ratio() -> None:
    rows = made_up_rows()
    rows["flood"][0] |= {"flooded_whole": False, "flooded_rmse_m": None, "flooded_failsafe": "mocap-lost"}
    answer = summary({"seed": 1, "quick": True, "folder": "."}, rows)["answer"]
    assert (answer["flood_ratio_max"], answer["flood_landings"]) == (None, 1)


@pytest.mark.full
@pytest.mark.realtime
def test_quick_study_finds_no_way_in(tmp_path: Path) -> None:
    answer = run(folder=tmp_path, seed=5, vehicle="research", jobs=2, quick=True)["answer"]
    counted = {key: answer[key] for key in ("accepted", "lockouts", "takeovers", "misreported", "crashes")}
    assert set(counted.values()) == {0}, counted
    assert answer["mutants_caught"] == answer["mutants"] == len(MUTANTS)
    assert answer["crowds_flown"] == answer["crowds"]
    assert answer["paths_opened"] == 0
    assert answer["flood_ratio_max"] < 1.2
