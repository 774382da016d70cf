"""A bad link costs little of a flight: what is measured rests on the estimate between poses."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from tests.narrowing import not_none
from trimtab.host.link.summary import FlightResult

CLEAN = {"loss": 0.0}


@pytest.mark.parametrize(
    ("seed", "burst"), [(8304, 5.0), pytest.param(8305, 5.0, marks=pytest.mark.full), (8306, 1.0)]
)
def test_bad_link_and_late_poses_track_within_half_as_much_again(
    fly: Callable[..., FlightResult], simulate: Callable[..., Any], tmp_path: Path, seed: int, burst: float
) -> None:
    clean = fly(simulate(world="empty", world_seed=seed, radio=CLEAN), log_path=tmp_path / "clean.mcap")
    bad = fly(simulate(world="bad-link", world_seed=seed, radio={"burst_frames": burst}))
    for result in (clean, bad):
        assert result.end is not None
        assert result.end.whole
        assert result.end.failsafe is None
        assert result.tracking_rmse_m is not None
    assert bad.link["up_lost_share"] > 0.15
    assert bad.link["mocap_age_ms_p99"] > 1.5 * clean.link["mocap_age_ms_p99"]
    assert not_none(bad.tracking_rmse_m) < 1.5 * not_none(clean.tracking_rmse_m)
