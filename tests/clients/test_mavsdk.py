"""MAVSDK: the session that docs/guide/clients.md shows, and what its telemetry, actions and offboard need."""

# pyright: reportMissingImports=false
# MAVSDK is of the extra `clients`.

from __future__ import annotations

import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

pytestmark = [pytest.mark.full, pytest.mark.realtime]

PAGE = Path(__file__).parent.parent.parent / "docs" / "guide" / "clients.md"


@pytest.fixture(autouse=True)
def _clients(require: Callable[[str], None]) -> None:
    require("clients")


def test_session_of_the_page_uploads_commits_flies_and_reads_back(
    serve: Callable[..., str], reference_file: Path, tmp_path: Path
) -> None:
    script, _ = re.findall(r"^```python\n(.*?)^```$", PAGE.read_text(), flags=re.MULTILINE | re.DOTALL)
    (tmp_path / "session.py").write_text(script)
    done = subprocess.run(
        [sys.executable, "session.py", f"udpout://{serve()}", str(reference_file)],
        cwd=tmp_path,
        stdout=subprocess.PIPE,
        text=True,
        check=True,
    )
    size = reference_file.stat().st_size
    for line in (
        "HOLD_S 1.5 BAT_CELLS 4",
        "command 31010 accepted",
        f"on board: live.ref ({size} bytes)",
        "identical: True",
        "command 300 accepted",
        "same bytes: True",
    ):
        assert line in done.stdout.splitlines()
    modes = re.search(r"^modes: (.*)$", done.stdout, flags=re.MULTILINE)
    assert modes is not None
    assert "MISSION" in modes[1].split()
    found = re.search(r"flew ([\d.]+) m north, ([\d.]+) m high", done.stdout)
    assert found is not None
    assert float(found[1]) == pytest.approx(0.6, abs=0.1)
    assert float(found[2]) == pytest.approx(1.2, abs=0.1)


@pytest.mark.parametrize(
    ("port", "url"),
    [("pty", "serial://{}:921600"), ("tcp:127.0.0.1:0", "tcpout://{}")],  # all others go over UDP
)
def test_mavsdk_connects_and_reads_parameters_over(
    port: str,
    url: str,
    serve: Callable[..., str],
    connect: Callable[[str], Any],
    require: Callable[[str], None],
) -> None:
    require("pty")
    vehicle = connect(url.format(serve(port)))
    found = vehicle.param.get_all_params()
    assert {row.name: row.value for row in found.int_params}["BAT_CELLS"] == 4
    assert {row.name: row.value for row in found.float_params}["MASS"] == pytest.approx(0.752)
    vehicle.param.set_param_int("BAT_CELLS", 6)
    assert vehicle.param.get_param_int("BAT_CELLS") == 6
    assert vehicle.info.get_version().flight_sw_major == 0
    vehicle.until(lambda: vehicle.battery_v > 12.0)


def test_mavsdk_takes_off_and_lands(serve: Callable[..., str], connect: Callable[[str], Any]) -> None:
    from mavsdk.plugins.telemetry import FlightMode, LandedState

    vehicle = connect(f"udpout://{serve()}")
    vehicle.until(lambda: vehicle.landed_state == LandedState.ON_GROUND)
    # Heartbeats tell the mode at 1 Hz, and the radio loses some: each phase takes several.
    for name in ("TAKEOFF_SPEED", "LAND_SPEED"):
        vehicle.param.set_param_float(name, 0.25)
    vehicle.until(lambda: vehicle.mode == FlightMode.READY)
    vehicle.take_off(1.0)
    vehicle.until(lambda: vehicle.landed_state == LandedState.IN_AIR)
    vehicle.until(lambda: vehicle.mode == FlightMode.HOLD)
    vehicle.until(lambda: vehicle.health.is_home_position_ok)
    health = vehicle.health
    assert (health.is_armable, health.is_local_position_ok, health.is_gyrometer_calibration_ok) == (True,) * 3
    assert (health.is_global_position_ok, health.is_magnetometer_calibration_ok) == (True, False)
    assert vehicle.telemetry.home().local_down_m == pytest.approx(0.0, abs=0.1)
    # The place of the origin that the parameters name.
    place = vehicle.telemetry.position()
    assert (place.latitude_deg, place.longitude_deg) == pytest.approx((47.397742, 8.545594), abs=1e-5)
    assert place.relative_altitude_m == pytest.approx(1.0, abs=0.15)
    assert place.absolute_altitude_m == pytest.approx(489.0, abs=0.15)
    vehicle.until(lambda: abs(vehicle.telemetry.altitude().altitude_relative_m - 1.0) < 0.15)
    assert abs((vehicle.telemetry.heading().heading_deg + 180.0) % 360.0 - 180.0) < 5.0
    vehicle.land()
    vehicle.until(lambda: vehicle.landed_state == LandedState.ON_GROUND)
    assert vehicle.place == pytest.approx((0.0, 0.0, 0.0), abs=0.2)
    assert vehicle.modes == {FlightMode.READY, FlightMode.TAKEOFF, FlightMode.HOLD, FlightMode.LAND}


def near(place: tuple[float, float, float], wanted: tuple[float, float, float], within: float) -> bool:
    return all(abs(a - b) < within for a, b in zip(place, wanted, strict=True))


def test_mavsdk_flies_offboard(serve: Callable[..., str], connect: Callable[[str], Any]) -> None:
    """Positions, velocities and attitude rates streamed by MAVSDK for 9 s, then hold and landing.

    MAVSDK ends its stream 4 s after the start unless the heartbeat shows PX4's offboard mode.
    """
    from mavsdk.plugins import offboard as o
    from mavsdk.plugins.telemetry import FlightMode

    vehicle = connect(f"udpout://{serve()}")
    vehicle.take_off(1.2)

    vehicle.offboard.set_position_ned(o.PositionNedYaw(0.0, 0.0, -1.2, 0.0))
    vehicle.offboard.start()
    vehicle.until(lambda: vehicle.mode == FlightMode.OFFBOARD)
    start = vehicle.positions
    vehicle.offboard.set_position_ned(o.PositionNedYaw(0.8, -0.5, -1.5, 45.0))
    vehicle.until(lambda: near(vehicle.place, (0.8, -0.5, -1.5), 0.1) and abs(vehicle.yaw_deg - 45.0) < 5.0)

    vehicle.offboard.set_velocity_ned(o.VelocityNedYaw(-0.4, 0.0, 0.0, 0.0))
    vehicle.until(lambda: abs(vehicle.telemetry.velocity_ned().north_m_s + 0.4) < 0.1)
    vehicle.until(lambda: near(vehicle.speed, (-0.4, 0.0, 0.0), 0.1) and vehicle.place[0] < 0.2)
    vehicle.offboard.set_position_ned(o.PositionNedYaw(0.0, 0.0, -1.5, 0.0))
    vehicle.until(lambda: near(vehicle.place, (0.0, 0.0, -1.5), 0.1))

    # About hover thrust and a slow turn: it yaws, and then a position brings it back.
    hover = (0.752 * 9.80665) / (4 * 8.5)
    vehicle.offboard.set_attitude_rate(o.AttitudeRate(0.0, 0.0, 40.0, hover))
    vehicle.until(lambda: vehicle.yaw_deg > 15.0)
    vehicle.offboard.set_position_ned(o.PositionNedYaw(0.0, 0.0, -1.5, 0.0))
    vehicle.until(lambda: near(vehicle.place, (0.0, 0.0, -1.5), 0.15) and abs(vehicle.yaw_deg) < 5.0)
    vehicle.until(lambda: vehicle.positions > start + 9 * 20)  # at 20 Hz
    assert vehicle.mode == FlightMode.OFFBOARD
    assert vehicle.offboard.is_active()
    vehicle.offboard.stop()
    vehicle.land()
    assert not any(word in text for text in vehicle.texts for word in ("fail", "lost", "setpoint"))


def test_mavsdk_lifts_off_in_offboard(serve: Callable[..., str], connect: Callable[[str], Any]) -> None:
    """MAVSDK's own example: arm, a first setpoint of zeros, start, and then up."""
    from mavsdk.plugins import offboard as o
    from mavsdk.plugins.telemetry import LandedState

    vehicle = connect(f"udpout://{serve()}")
    vehicle.until(lambda: vehicle.health is not None and vehicle.health.is_armable)
    vehicle.telemetry.set_rate_position_velocity_ned(20.0)
    vehicle.action.arm()
    vehicle.offboard.set_position_ned(o.PositionNedYaw(0.0, 0.0, 0.0, 0.0))
    vehicle.offboard.start()
    vehicle.offboard.set_position_ned(o.PositionNedYaw(0.0, 0.0, -1.0, 0.0))
    vehicle.until(lambda: near(vehicle.place, (0.0, 0.0, -1.0), 0.1))
    vehicle.until(lambda: vehicle.landed_state == LandedState.IN_AIR)
    vehicle.offboard.set_position_ned(o.PositionNedYaw(0.6, 0.0, -1.0, 90.0))
    vehicle.until(lambda: near(vehicle.place, (0.6, 0.0, -1.0), 0.1) and abs(vehicle.yaw_deg - 90.0) < 5.0)
    vehicle.offboard.stop()
    vehicle.land()


def test_mavsdk_cannot_sign_and_is_told_why_it_may_not_command(
    serve_with_key: Callable[..., str], connect: Callable[[str], Any]
) -> None:
    """MAVSDK 4.1 has no call that sets a key. It reads a vehicle with one, and commands time out."""
    from mavsdk.plugins.action import ActionError

    vehicle = connect(f"udpout://{serve_with_key()}")
    assert vehicle.param.get_param_float("HOLD_S") == 1.0
    assert len(vehicle.param.get_all_params().float_params) > 90
    with pytest.raises(ActionError, match="TIMEOUT"):
        vehicle.action.arm()
    vehicle.until(lambda: "signed messages only: give this station the key" in vehicle.texts)
    assert not vehicle.armed
