"""The study that measures rules of tracing: its worlds, its numbers, and that it resumes."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from trimtab.host.base.errors import UsageError
from trimtab.host.trace.decision.rules import MEASURED, table
from trimtab.sitl.studies import calibrate
from trimtab.sitl.studies.flights import Programme
from trimtab.sitl.studies.scoring.calibration import Measured, rules_in_force
from trimtab.sitl.studies.worlds import plan_worlds


def test_every_rule_that_claims_a_measurement_is_measured_here() -> None:
    measured = {name.partition(",")[0] for name in rules_in_force()}
    assert {row.name for row in table() if row.source == MEASURED} <= measured
    assert len(rules_in_force()) == len(Measured._fields)


def test_worlds_hold_nothing_and_share_no_seed_with_a_blind_study() -> None:
    worlds = [calibrate.planned_world(7, index) for index in range(20)]
    assert {world.kinds for world in worlds} == {()}
    assert len({world.seed for world in worlds}) == 20
    blind = {world.seed for world in plan_worlds(7, 30, ["linear-drag", "wind", "mass", "battery-sag"])}
    assert blind.isdisjoint(world.seed for world in worlds)
    assert calibrate.planned_world(7, 3) == calibrate.planned_world(7, 3)


def test_rules_are_a_quantile_a_mean_and_a_root_mean_square() -> None:
    powers = np.tile([5.0, 4.0, 3.0, 2.0], (21, 1))
    table = np.column_stack([np.linspace(0.0, 1.0, 21), powers, np.full(21, 9.0)])
    table[0, 4] = 4.1
    np.testing.assert_allclose(calibrate.rules_of(table), [0.95, 5.0, 4.0, 3.0, 2.1, 3.0])


def test_interval_of_worlds_that_agree_is_a_point_and_of_others_is_not() -> None:
    alike = [Measured(0.1, 5.0, 4.0, 3.0, 2.0, error_power=4.0)._asdict()] * 5
    row = calibrate.calibrated(alike, 1)["min_widening"]
    assert (row["measured"], row["low"], row["high"]) == (2.0, 2.0, 2.0)
    spread = [*alike, Measured(0.1, 5.0, 4.0, 3.0, 2.0, error_power=16.0)._asdict()]
    row = calibrate.calibrated(spread, 1)["min_widening"]
    assert row["low"] < row["measured"] < row["high"]
    assert calibrate.calibrated(spread, 1) == calibrate.calibrated(spread, 1)


def test_one_world_is_refused(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="--worlds 1"):
        calibrate.run(folder=tmp_path, seed=1, vehicle="research", jobs=1, worlds=1)


@pytest.mark.full
def test_study_measures_worlds_and_resumes(tmp_path: Path, short_programme: Programme) -> None:
    def run() -> dict[str, Any]:
        return calibrate.run(
            folder=tmp_path, seed=4, vehicle="research", jobs=2, worlds=2, programme=short_programme
        )

    first = run()
    logs = {path: path.stat().st_mtime_ns for path in tmp_path.glob("worlds/*/flights/*.mcap")}
    assert len(logs) == 2 * len(short_programme.flights())
    again = run()
    assert again == first
    assert {path: path.stat().st_mtime_ns for path in logs} == logs
    assert all(np.isfinite(row["measured"]) for row in first["answer"]["rules"].values())
