"""Random sequences against the table of invariants: 20 in `make test`, 300 in `make test-all`."""

from __future__ import annotations

import json

import pytest

from trimtab.firmware_model.flight.invariants import BY_NAME
from trimtab.sitl.studies.policy import fly_sequence, run_policy
from trimtab.sitl.studies.policy.__main__ import main
from trimtab.sitl.studies.policy.mutants import MUTANTS

SEQUENCES, CHUNK = 300, 10
CHUNKS = [
    pytest.param(range(first, first + CHUNK), marks=() if first < 2 * CHUNK else pytest.mark.full)
    for first in range(0, SEQUENCES, CHUNK)
]


@pytest.mark.parametrize("seeds", CHUNKS, ids=lambda seeds: f"{seeds.start}-{seeds.stop - 1}")
def test_random_sequences_break_no_invariant(seeds):
    report = run_policy(seeds)
    broken = {name: row.broken for name, row in report.rows.items() if row.broken}
    assert broken == {}
    assert report.sequences == CHUNK


@pytest.mark.full
@pytest.mark.parametrize("mutant", MUTANTS)
def test_weakened_vehicle_is_caught(mutant):
    assert run_policy(range(SEQUENCES), mutant=mutant, until_broken=True).broken_seeds


def test_weakened_vehicle_is_caught_by_the_row_that_it_breaks():
    report = run_policy(range(3), mutant="parameters-in-flight", until_broken=True)
    assert report.rows["parameters"].broken


def test_sequences_exercise_most_of_the_table():
    report = run_policy(range(5))
    exercised = {name for name, row in report.rows.items() if row.exercised}
    assert exercised >= set(BY_NAME) - {"impact", "impact-blind"}


def test_sequence_is_the_same_for_the_same_seed():
    assert fly_sequence(11) == fly_sequence(11)


def test_report_as_json_names_each_invariant(capsys):
    assert main(["--seeds", "0:2", "--workers", "1", "--json"]) == 0
    answer = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert answer["sequences"] == 2
    assert set(answer["invariants"]) == set(BY_NAME)


def test_mutant_that_is_caught_ends_with_success(capsys):
    assert main(["--seeds", "0:9", "--workers", "1", "--mutant", "parameters-in-flight"]) == 0
    assert "broken: seed" in capsys.readouterr().out


@pytest.mark.parametrize("seeds", ["x", "5:2", "3:", ":4", "-1"])
def test_seeds_that_are_no_range_are_a_usage_error(seeds):
    with pytest.raises(SystemExit) as error:
        main([f"--seeds={seeds}"])
    assert error.value.code == 2
