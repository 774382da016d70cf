"""Two processes that plan and fly in one folder at once leave two whole flights, each with its own files."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.sessions.pairs import fly_lockstep_pair, fly_port_pair, plan_pair, plan_short, two_vehicles


def test_flights_started_together_in_one_folder_lose_nothing(tmp_path: Path) -> None:
    plan_short(tmp_path)
    faults = [fault for _ in range(3) for fault in fly_lockstep_pair(tmp_path)]
    assert faults == []
    logs = sorted(path.name for path in tmp_path.glob("*.mcap"))
    assert logs == [f"short-{number}.mcap" for number in range(6)]
    assert len(list(tmp_path.glob("*.truth.json"))) == 6


def test_plans_made_together_under_one_name_belong_to_their_record(tmp_path: Path) -> None:
    plan_short(tmp_path)
    assert plan_pair(tmp_path) == []


@pytest.mark.full
@pytest.mark.realtime
def test_flights_of_two_vehicles_in_one_folder_lose_nothing(tmp_path: Path) -> None:
    plan_short(tmp_path)
    with two_vehicles(tmp_path) as vehicles:
        assert fly_port_pair(tmp_path, vehicles) == []
    assert sorted(path.name for path in tmp_path.glob("*.mcap")) == ["short-0.mcap", "short-1.mcap"]
