"""Flights beside another station: what it cannot do, what it may do, and what `fly` then says."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from trimtab.host.base.errors import FlightFailed
from trimtab.host.link.fly import FlightEnded
from trimtab.host.link.summary import FlightResult
from trimtab.host.log import read_flight
from trimtab.protocol import messages as m
from trimtab.protocol.messages import mavlink
from trimtab.sitl.studies.attack.flood import FloodedVehicle, flood_frames
from trimtab.sitl.studies.attack.interference import KINDS
from trimtab.sitl.studies.attack.stranger import ADDRESS, SharedVehicle, Stranger

Fly = Callable[..., FlightResult]
Simulate = Callable[..., Any]

REFUSED = ("hold", "disarm", "forced-disarm", "arm", "takeoff", "start", "offboard", "poses", "upload-swap")


@pytest.mark.parametrize("kind", [*REFUSED, "upload-abort"])
def test_stranger_in_flight_cannot(kind: str, fly: Fly, simulate: Simulate, tmp_path: Path) -> None:
    stranger = Stranger(KINDS[kind]())
    result = fly(SharedVehicle(simulate(), stranger))
    assert result.end is not None
    assert result.end.whole
    assert result.end.takeover is None
    assert result.tracking_rmse_m is not None
    assert result.tracking_rmse_m < 0.05
    assert read_flight(tmp_path / "flight.mcap").tracking_whole
    results = {result for _, result in stranger.acks}
    assert mavlink.MAV_RESULT_ACCEPTED not in results
    if kind not in ("offboard", "poses", "upload-swap", "upload-abort"):
        assert results == {mavlink.MAV_RESULT_TEMPORARILY_REJECTED}  # of some; the others were too many
        assert "owned by station 255:190" in " ".join(stranger.texts)
    else:
        assert "of station 77:190 refused" in " ".join(stranger.texts)


@pytest.mark.parametrize(("kind", "command"), [("land", "a landing"), ("terminate", "motors off")])
def test_stranger_may_end_a_flight_and_fly_names_it(
    kind: str, command: str, fly: Fly, simulate: Simulate
) -> None:
    stranger = Stranger(KINDS[kind]())
    with pytest.raises(FlightEnded) as ended:
        fly(SharedVehicle(simulate(), stranger))
    end = ended.value.result.end
    assert end is not None
    assert not end.whole
    assert end.takeover is not None
    assert (end.takeover.system, end.takeover.component, end.takeover.command) == (*ADDRESS, command)
    assert f"station 77:190 commanded {command}" in str(ended.value)
    assert "by station 77:190" in " ".join(stranger.texts)


@pytest.mark.parametrize(("value", "kind"), [(0, "land"), (0, "terminate"), (1, "terminate")])
def test_parameter_forbids_others_to_end_a_flight(
    value: int, kind: str, fly: Fly, simulate: Simulate
) -> None:
    result = fly(SharedVehicle(simulate(), Stranger(KINDS[kind]())), parameters={"OWN_OTHERS": float(value)})
    assert result.end is not None
    assert result.end.whole


@pytest.mark.parametrize("kind", ["hold", "land", "forced-disarm", "terminate", "offboard"])
def test_flight_taken_over_under_the_hosts_address_is_not_reported_as_flown(
    kind: str, fly: Fly, simulate: Simulate
) -> None:
    """Without signing, a stranger can use the owner's address: the flight ends, and `fly` says so."""
    with pytest.raises(FlightEnded) as ended:
        fly(SharedVehicle(simulate(), Stranger(KINDS[kind](), m.HOST)))
    end = ended.value.result.end
    assert end is not None
    assert not end.whole
    assert end.takeover is not None
    assert "which has this host's address" in str(ended.value)


def test_parameter_changed_by_another_station_ends_the_preparation(fly: Fly, simulate: Simulate) -> None:
    """The stranger sets it after the host has read the parameters and before it arms."""

    def act(stranger: Stranger) -> list[m.Message]:
        # The host arms next: it has read the parameters long before.
        if "gyro calibrated" not in stranger.texts or stranger.state > mavlink.TRIMTAB_STATE_STANDBY:
            return []
        return [m.ParamSet(*m.VEHICLE, b"HOLD_S", 2.5, mavlink.MAV_PARAM_TYPE_REAL32)]

    stranger = Stranger(act)
    with pytest.raises(FlightFailed, match=r"another station set HOLD_S from 1 to 2\.5"):
        fly(SharedVehicle(simulate(), stranger))
    assert "HOLD_S set to 2.5 by station 77:190" in " ".join(stranger.texts)


def test_poses_of_a_stranger_before_arming_are_not_flown(fly: Fly, simulate: Simulate) -> None:
    """A stranger that was first to send poses gives way to the host that arms."""

    def act(stranger: Stranger) -> list[m.Message]:
        estimate = stranger.estimate
        if estimate is None or stranger.state > mavlink.TRIMTAB_STATE_STANDBY:
            return []
        return [m.AttPosMocap(estimate.tick * 1000 + 2000, (1.0, 0.0, 0.0, 0.0), 0.3, 0.3, 0.0)]

    stranger = Stranger(act)
    result = fly(SharedVehicle(simulate(), stranger))
    assert result.end is not None
    assert result.end.whole
    assert result.tracking_rmse_m is not None
    assert result.tracking_rmse_m < 0.05
    assert "poses of another station" in " ".join(stranger.texts)


def test_flood_of_ten_thousand_packets_a_second_costs_no_accuracy(fly: Fly, simulate: Simulate) -> None:
    quiet = fly(simulate())
    Path(quiet.log).unlink()
    vehicle = FloodedVehicle(simulate(), flood_frames(600, seed=1), 10_000)
    flooded = fly(vehicle)
    assert vehicle.sent > 100_000
    assert flooded.end is not None
    assert flooded.end.whole
    assert flooded.tracking_rmse_m is not None
    assert quiet.tracking_rmse_m is not None
    assert flooded.tracking_rmse_m < 1.2 * quiet.tracking_rmse_m
