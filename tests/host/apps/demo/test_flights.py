"""Flights of the demo: the pty on the way in, the seal on the way out."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Callable
from pathlib import Path

import pytest

from trimtab.host.apps.demo.flights import Airfield, upload_through_pty
from trimtab.host.base.errors import FlightFailed, UsageError
from trimtab.host.link.simulated import TRUTH_SUFFIX
from trimtab.host.log import read_flight
from trimtab.host.vehicle import ConfigurationError
from trimtab.protocol.blobs import Reference

GAPS = """
description = "For a test: the cameras fall silent in the air"
tolerances = false

[mocap]
gaps_s = [[6.0, 60.0]]
"""


@pytest.mark.realtime
def test_flight_after_a_pty_starts_from_power_up_whatever_the_upload_took(
    airfield: Airfield, hop: Reference, tmp_path: Path, require: Callable[[str], None]
) -> None:
    require("pty")
    logs = []
    for name in ("a.mcap", "b.mcap"):
        simulated = airfield.power_up(hop, 1)
        port, sent = upload_through_pty(simulated, hop)
        assert port.startswith("/dev/")
        assert sent.id == hop.id
        simulated.power_cycle(1)
        assert simulated.now_us == 0
        airfield.fly_with(simulated, hop, 1, tmp_path / name)
        logs.append((tmp_path / name).read_bytes())
    assert logs[0] == logs[1]


def test_flight_without_its_reference_on_board_is_refused(
    airfield: Airfield, hop: Reference, tmp_path: Path
) -> None:
    with pytest.raises(UsageError, match="on board is none"):
        airfield.fly_with(airfield.power_up(hop, 1), hop, 1, tmp_path / "a.mcap")
    assert not list(tmp_path.iterdir())


def test_flight_that_writes_no_log_leaves_the_truth_of_the_old_one(
    airfield: Airfield, hop: Reference, tmp_path: Path
) -> None:
    log = tmp_path / "a.mcap"
    airfield.fly(hop, 3, log)
    before = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    assert len(before) == 2
    with pytest.raises(UsageError, match="on board is none"):
        airfield.fly_with(airfield.power_up(hop, 1), hop, 1, log)
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == before


def test_flight_leaves_its_truth_sealed_beside_the_log(
    airfield: Airfield, hop: Reference, tmp_path: Path
) -> None:
    log = tmp_path / "a.mcap"
    result = airfield.fly(hop, 3, log)
    truth = json.loads(log.with_name(log.name + TRUTH_SUFFIX).read_text())
    flight = read_flight(log)
    assert truth["log"] == flight.id == result.log_id
    assert truth["uid"] == flight.metadata["session_uid"]
    assert truth["world_seed"] == airfield.world_seed
    assert len(truth["effects"]) >= 2
    assert flight.metadata["flight"] == "3"
    assert flight.metadata["seed"] == "5"


def test_flight_that_ends_in_failsafe_says_which_and_leaves_a_readable_log(
    airfield: Airfield, hop: Reference, tmp_path: Path
) -> None:
    world = tmp_path / "gaps.toml"
    world.write_text(GAPS, encoding="utf-8")
    field = dataclasses.replace(airfield, world=str(world))
    log = tmp_path / "a.mcap"
    with pytest.raises(FlightFailed, match=r"flight 2: .*mocap lost.*a\.mcap") as caught:
        field.fly(hop, 2, log)
    assert caught.value.exit_code == 1
    assert read_flight(log).failsafe == "mocap-lost"
    assert log.with_name(log.name + TRUTH_SUFFIX).is_file()


def test_airfield_in_a_world_nobody_knows_is_refused_before_anything_is_planned(airfield: Airfield) -> None:
    with pytest.raises(ConfigurationError, match="no such world"):
        dataclasses.replace(airfield, world="nowhere").check()
