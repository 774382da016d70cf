"""MAVSDK: the session that docs/guide/clients.md shows, and what its telemetry, actions and offboard need."""

# pyright: reportMissingImports=false
# MAVSDK is of the extra `clients`.

from __future__ import annotations

import re
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack
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
    (script,) = re.findall(r"^```python\n(.*?)^```$", PAGE.read_text(), flags=re.MULTILINE | re.DOTALL)
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
    found = re.search(r"flew ([\d.]+) m north, ([\d.]+) m high", done.stdout)
    assert found is not None
    assert float(found[1]) == pytest.approx(0.6, abs=0.1)
    assert float(found[2]) == pytest.approx(1.2, abs=0.1)


class Watched:
    """MAVSDK's plugins for one vehicle, and waiting for what its subscriptions tell.

    Attributes:
        place: north, east, down of the last position. armed, landed_state, health, mode: the last told.
    """

    def __init__(self, system: Any) -> None:
        from mavsdk.plugins.action import Action
        from mavsdk.plugins.info import Info
        from mavsdk.plugins.offboard import Offboard
        from mavsdk.plugins.param import Param
        from mavsdk.plugins.telemetry import Telemetry

        self.action, self.info, self.param = Action(system), Info(system), Param(system)
        self.offboard, self.telemetry = Offboard(system), Telemetry(system)
        self.place = (0.0, 0.0, 0.0)
        self.speed = (0.0, 0.0, 0.0)
        self.yaw_deg = 0.0
        self.armed = False
        self.landed_state: Any = None
        self.health: Any = None
        self.battery_v = 0.0
        self.texts: list[str] = []
        self._changed = threading.Condition()
        watch = self.telemetry
        watch.subscribe_position_velocity_ned(self._take(self._move))
        watch.subscribe_attitude_euler(self._take(lambda now: self._set("yaw_deg", now.yaw_deg)))
        watch.subscribe_armed(self._take(lambda now: self._set("armed", now)))
        watch.subscribe_landed_state(self._take(lambda now: self._set("landed_state", now)))
        watch.subscribe_health(self._take(lambda now: self._set("health", now)))
        watch.subscribe_battery(self._take(lambda now: self._set("battery_v", now.voltage_v)))
        watch.subscribe_status_text(self._take(lambda now: self.texts.append(now.text)))

    def _take(self, act: Callable[[Any], None]) -> Callable[[Any, Any], None]:
        def on_data(data: Any, _: Any) -> None:
            with self._changed:
                act(data)
                self._changed.notify_all()

        return on_data

    def _set(self, name: str, value: Any) -> None:
        setattr(self, name, value)

    def _move(self, now: Any) -> None:
        self.place = (now.position.north_m, now.position.east_m, now.position.down_m)
        self.speed = (now.velocity.north_m_s, now.velocity.east_m_s, now.velocity.down_m_s)

    def until(self, condition: Callable[[], bool]) -> None:
        """Waits until the condition holds; it is looked at when something is told."""
        with self._changed:
            self._changed.wait_for(condition)

    def take_off(self, height_m: float) -> None:
        """Armed as soon as it may be, then in the air at that height."""
        from mavsdk.plugins.telemetry import LandedState

        self.until(lambda: self.health is not None and self.health.is_armable)
        self.telemetry.set_rate_position_velocity_ned(20.0)
        self.action.arm()
        self.action.set_takeoff_altitude(height_m)
        self.action.takeoff()
        self.until(lambda: self.landed_state == LandedState.IN_AIR)
        assert abs(self.place[2] + height_m) < 0.15

    def land(self) -> None:
        """Back on the floor and disarmed."""
        self.action.land()
        self.until(lambda: not self.armed)


@pytest.fixture
def connect() -> Iterator[Callable[[str], Watched]]:
    """Connects MAVSDK: connect("udpout://HOST:PORT")."""
    from mavsdk import ComponentType, Configuration, Mavsdk

    with ExitStack() as stack:

        def start(url: str) -> Watched:
            mavsdk = Mavsdk(Configuration.create_with_component_type(ComponentType.GROUND_STATION))
            stack.callback(mavsdk.destroy)
            mavsdk.add_any_connection(url)
            system = mavsdk.first_autopilot(timeout_s=60.0)
            assert system is not None
            return Watched(system)

        yield start


@pytest.mark.parametrize(
    ("port", "url"),
    [("pty", "serial://{}:921600"), ("tcp:127.0.0.1:0", "tcpout://{}"), ("udp:127.0.0.1:0", "udpout://{}")],
)
def test_mavsdk_connects_and_reads_parameters_over(
    port: str,
    url: str,
    serve: Callable[..., str],
    connect: Callable[[str], Watched],
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


def test_mavsdk_takes_off_and_lands(serve: Callable[..., str], connect: Callable[[str], Watched]) -> None:
    from mavsdk.plugins.telemetry import LandedState

    vehicle = connect(f"udpout://{serve()}")
    vehicle.until(lambda: vehicle.landed_state == LandedState.ON_GROUND)
    vehicle.take_off(1.0)
    vehicle.until(lambda: vehicle.landed_state == LandedState.IN_AIR)
    vehicle.until(lambda: vehicle.health.is_home_position_ok)
    health = vehicle.health
    assert (health.is_armable, health.is_local_position_ok, health.is_gyrometer_calibration_ok) == (True,) * 3
    assert (health.is_global_position_ok, health.is_magnetometer_calibration_ok) == (False, False)
    assert vehicle.telemetry.home().local_down_m == pytest.approx(0.0, abs=0.1)
    vehicle.land()
    vehicle.until(lambda: vehicle.landed_state == LandedState.ON_GROUND)
    assert vehicle.place == pytest.approx((0.0, 0.0, 0.0), abs=0.2)


def near(place: tuple[float, float, float], wanted: tuple[float, float, float], within: float) -> bool:
    return all(abs(a - b) < within for a, b in zip(place, wanted, strict=True))


def test_mavsdk_flies_offboard(serve: Callable[..., str], connect: Callable[[str], Watched]) -> None:
    """Positions, velocities and attitude rates streamed by MAVSDK, then hold and landing."""
    from mavsdk.plugins import offboard as o

    vehicle = connect(f"udpout://{serve()}")
    # A busy machine may hold MAVSDK's stream up; its loss is tested in simulated time.
    vehicle.param.set_param_float("FS_OFFB_S", 5.0)
    vehicle.take_off(1.2)

    vehicle.offboard.set_position_ned(o.PositionNedYaw(0.0, 0.0, -1.2, 0.0))
    vehicle.offboard.start()
    vehicle.offboard.set_position_ned(o.PositionNedYaw(0.8, -0.5, -1.5, 45.0))
    vehicle.until(lambda: near(vehicle.place, (0.8, -0.5, -1.5), 0.1) and abs(vehicle.yaw_deg - 45.0) < 5.0)

    vehicle.offboard.set_velocity_ned(o.VelocityNedYaw(-0.4, 0.0, 0.0, 0.0))
    vehicle.until(lambda: near(vehicle.speed, (-0.4, 0.0, 0.0), 0.1) and vehicle.place[0] < 0.2)
    vehicle.offboard.set_position_ned(o.PositionNedYaw(0.0, 0.0, -1.5, 0.0))
    vehicle.until(lambda: near(vehicle.place, (0.0, 0.0, -1.5), 0.1))

    # About hover thrust and a slow turn: it yaws, and then a position brings it back.
    hover = (0.752 * 9.80665) / (4 * 8.5)
    vehicle.offboard.set_attitude_rate(o.AttitudeRate(0.0, 0.0, 40.0, hover))
    vehicle.until(lambda: vehicle.yaw_deg > 15.0)
    vehicle.offboard.set_position_ned(o.PositionNedYaw(0.0, 0.0, -1.5, 0.0))
    vehicle.until(lambda: near(vehicle.place, (0.0, 0.0, -1.5), 0.15) and abs(vehicle.yaw_deg) < 5.0)
    vehicle.offboard.stop()
    vehicle.land()
    assert not any("fail" in text or "lost" in text for text in vehicle.texts)


def test_mavsdk_lifts_off_in_offboard(serve: Callable[..., str], connect: Callable[[str], Watched]) -> None:
    """MAVSDK's own example: arm, a first setpoint of zeros, start, and then up."""
    from mavsdk.plugins import offboard as o
    from mavsdk.plugins.telemetry import LandedState

    vehicle = connect(f"udpout://{serve()}")
    vehicle.param.set_param_float("FS_OFFB_S", 5.0)
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
    serve_with_key: Callable[..., str], connect: Callable[[str], Watched]
) -> None:
    """MAVSDK 4.1 has no call that sets a key. It reads a vehicle with one, and commands time out."""
    from mavsdk.plugins.action import ActionError

    vehicle = connect(f"udpout://{serve_with_key()}")
    assert vehicle.param.get_param_float("HOLD_S") == 1.0
    with pytest.raises(ActionError, match="TIMEOUT"):
        vehicle.action.arm()
    vehicle.until(lambda: "signed messages only: give this station the key" in vehicle.texts)
    assert not vehicle.armed
