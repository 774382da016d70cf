"""pymavlink's mavutil with the stock dialect: every port, every small service, several stations at once."""

from __future__ import annotations

import re
import struct
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

PAGE = Path(__file__).parent.parent.parent / "docs" / "guide" / "clients.md"
pytestmark = [pytest.mark.full, pytest.mark.realtime]

ACCEPTED, TEMPORARILY_REJECTED, DENIED, UNSUPPORTED = 0, 1, 2, 3
REAL32, INT32 = 9, 6
ARM, TAKEOFF, START = 400, 22, 300
REQUEST_MESSAGE, SET_INTERVAL, GET_INTERVAL = 512, 511, 510
AUTOPILOT_VERSION, HOME_POSITION, ATTITUDE, LOCAL_POSITION = 148, 242, 30, 32


def as_int(value: float) -> int:
    """The int32 whose bits travel in a float."""
    return struct.unpack("<i", struct.pack("<f", value))[0]


def as_float(value: int) -> float:
    """The float that has the bits of an int32."""
    return struct.unpack("<f", struct.pack("<i", value))[0]


@pytest.mark.parametrize(
    ("port", "url"), [("pty", ""), ("tcp:127.0.0.1:0", "tcp:")]
)  # all others go over UDP
def test_mavutil_reads_and_sets_parameters_over(
    port: str,
    url: str,
    serve: Callable[..., str],
    station: Callable[..., Any],
    require: Callable[[str], None],
) -> None:
    require("pty")
    own = station(url + serve(port))
    heartbeat = own.answer("HEARTBEAT", fits=lambda m: m.get_srcComponent() == 1)
    assert heartbeat.mavlink_version == 3
    everything = own.parameters()
    assert everything["MASS"] == (pytest.approx(0.752), REAL32)
    assert everything["BAT_CELLS"][1] == INT32
    assert as_int(everything["BAT_CELLS"][0]) == 4

    assert own.set_parameter("HOLD_S", 1.5, REAL32).param_value == 1.5
    assert as_int(own.set_parameter("BAT_CELLS", as_float(6), INT32).param_value) == 6
    assert own.set_parameter("MASS", -1.0, REAL32).param_value == pytest.approx(0.752)  # refused
    again = own.parameters()
    assert again.keys() == everything.keys()
    assert again["HOLD_S"][0] == 1.5
    assert as_int(again["BAT_CELLS"][0]) == 6


def test_mavutil_cannot_arm_where_no_poses_come(
    serve: Callable[..., str], station: Callable[..., Any]
) -> None:
    own = station("tcp:" + serve("tcp:127.0.0.1:0"))
    own.answer("HEARTBEAT")
    while not any("no mocap" in text for text in own.texts):  # a text may be lost
        assert own.command(ARM, 1) == own.command_int(ARM, 1) == TEMPORARILY_REJECTED
    assert not own.armed


LOSSLESS = """description = "A radio that loses, repeats and damages nothing"
tolerances = true
[radio]
loss = 0.0
duplicate = 0.0
corrupt = 0.0
"""


@pytest.mark.parametrize("lossless", [True, False])
def test_mavutil_shows_the_loss_of_the_link(
    lossless: bool, serve: Callable[..., str], station: Callable[..., Any], tmp_path: Path
) -> None:
    """mavutil counts 255 lost messages for each that another message of its component overtook."""
    world = tmp_path / "lossless.toml"
    world.write_text(LOSSLESS)
    own = station("udpout:" + serve(sitl=["--world", str(world)] if lossless else []))
    own.answer("HEARTBEAT", fits=lambda m: m.get_srcComponent() == 1)
    own.link.mav.request_data_stream_send(1, 1, own.mavlink.MAV_DATA_STREAM_ALL, 20, 1)
    own.parameters()
    own.until(lambda: own.link.mav_count > 1500)
    assert own.link.packet_loss() == pytest.approx(100.0 * own.downlink_loss(), abs=1.0)
    if lossless:
        assert own.link.mav_loss == 0


def test_script_of_the_page_reads_private_messages(serve: Callable[..., str], tmp_path: Path) -> None:
    """mavutil with Trimtab's dialect as its own, in a process of its own: the dialect is global."""
    _, script = re.findall(r"^```python\n(.*?)^```$", PAGE.read_text(), flags=re.MULTILINE | re.DOTALL)
    (tmp_path / "watch.py").write_text(script)
    done = subprocess.run(
        [sys.executable, "watch.py", f"udpout:{serve()}"],
        cwd=tmp_path,
        stdout=subprocess.PIPE,
        text=True,
        check=True,
    )
    motors, state, loss = done.stdout.splitlines()[-3:]
    assert motors.startswith("motor commands [")
    assert state == "state 2"
    found = re.fullmatch(r"([\d.]+) % of \d+ messages lost", loss)
    assert found is not None
    assert float(found[1]) < 10.0


def test_mavutil_takes_off_and_lands(serve: Callable[..., str], station: Callable[..., Any]) -> None:
    own = station("udpout:" + serve())
    own.answer("HEARTBEAT")
    assert own.command(TAKEOFF, 0, 0, 0, 0, 0, 0, 1.0) == TEMPORARILY_REJECTED  # not armed
    own.arm()
    own.take_off_and_land()
    assert own.track[-1][2] == pytest.approx(0.0, abs=0.15)


def test_mavutil_sets_the_origin_of_the_globe(serve: Callable[..., str], station: Callable[..., Any]) -> None:
    own = station("udpout:" + serve())
    own.answer("HEARTBEAT", fits=lambda m: m.get_srcComponent() == 1)
    latitude, longitude, altitude_mm = -335000001, 1512345678, 12_500
    told = own.answer(
        "GPS_GLOBAL_ORIGIN",
        lambda: own.link.mav.set_gps_global_origin_send(1, latitude, longitude, altitude_mm),
    )
    assert (told.latitude, told.longitude, told.altitude) == (latitude, longitude, altitude_mm)
    globe = own.answer("GLOBAL_POSITION_INT", fits=lambda m: m.lat < 0)
    assert (globe.lat, globe.lon) == pytest.approx((latitude, longitude), abs=50)  # half a metre
    assert globe.alt == pytest.approx(altitude_mm, abs=100)
    assert own.answer("VFR_HUD").groundspeed < 0.1


def test_mavutil_small_services(on_the_floor: str, station: Callable[..., Any]) -> None:
    own = station("udpout:" + on_the_floor)
    own.answer("HEARTBEAT")

    # Commands, long and int alike.
    while not any("start refused" in text for text in own.texts):  # a text may be lost
        assert own.command(START) == own.command_int(START) == TEMPORARILY_REJECTED
    assert own.command(31999) == own.command_int(31999) == UNSUPPORTED

    # A message once, then at a rate, then no more.
    assert own.command(REQUEST_MESSAGE, AUTOPILOT_VERSION) == ACCEPTED
    version = own.answer("AUTOPILOT_VERSION", lambda: own.command(REQUEST_MESSAGE, AUTOPILOT_VERSION))
    assert version.capabilities & own.mavlink.MAV_PROTOCOL_CAPABILITY_FTP
    home = own.answer("HOME_POSITION", lambda: own.command(REQUEST_MESSAGE, HOME_POSITION))
    assert (home.x, home.y, home.z) == pytest.approx((0.0, 0.0, 0.0), abs=0.1)
    assert own.command(REQUEST_MESSAGE, 65000) in (DENIED, UNSUPPORTED)
    assert own.command(SET_INTERVAL, LOCAL_POSITION, 100_000) == ACCEPTED
    interval = own.answer("MESSAGE_INTERVAL", lambda: own.command(GET_INTERVAL, LOCAL_POSITION))
    assert (interval.message_id, interval.interval_us) == (LOCAL_POSITION, 100_000)
    own.until(lambda: len(own.track) > 20)
    assert own.track[-1] == pytest.approx((0.0, 0.0, 0.0), abs=0.05)
    assert own.command(SET_INTERVAL, 65000, 100_000) in (DENIED, UNSUPPORTED)

    # Clocks.
    first = own.answer("TIMESYNC", lambda: own.link.mav.timesync_send(0, 1234), lambda m: m.ts1 == 1234)
    second = own.answer("TIMESYNC", lambda: own.link.mav.timesync_send(0, 1235), lambda m: m.ts1 == 1235)
    assert 0 < first.tc1 < second.tc1

    # Missions: there are none, and nobody waits for that answer.
    for kind in (0, 1, 2):
        count = own.answer(
            "MISSION_COUNT",
            lambda kind=kind: own.link.mav.mission_request_list_send(1, 1, kind),
            lambda m, kind=kind: m.mission_type == kind,
        )
        assert count.count == 0


def test_mavutil_streams_what_a_station_watches(on_the_floor: str, station: Callable[..., Any]) -> None:
    """A heartbeat is enough for modest telemetry; REQUEST_DATA_STREAM is understood too."""
    own = station("udpout:" + on_the_floor)
    own.answer("HEARTBEAT", fits=lambda m: m.get_srcComponent() == 1)
    own.link.mav.request_data_stream_send(1, 1, own.mavlink.MAV_DATA_STREAM_ALL, 4, 1)
    attitude = own.answer("ATTITUDE")
    assert abs(attitude.roll) < 0.05
    assert own.answer("BATTERY_STATUS").voltages[0] > 12_000
    assert own.answer("EXTENDED_SYS_STATE").landed_state == own.mavlink.MAV_LANDED_STATE_ON_GROUND
    needed = own.mavlink.MAV_SYS_STATUS_SENSOR_VISION_POSITION | own.mavlink.MAV_SYS_STATUS_SENSOR_3D_GYRO
    own.answer("SYS_STATUS", fits=lambda m: m.onboard_control_sensors_health & needed == needed)


def test_several_stations_each_get_their_own_answers(on_the_floor: str, station: Callable[..., Any]) -> None:
    stations = [station(f"udpout:{on_the_floor}", system=system) for system in (201, 202, 203)]
    for own in stations:
        own.answer("HEARTBEAT")
    assert [own.command(REQUEST_MESSAGE, AUTOPILOT_VERSION) for own in stations] == [ACCEPTED] * 3
    wanted = [1.1, 1.2, 1.3]
    for own, value in zip(stations, wanted, strict=True):
        set_to = own.set_parameter("HOLD_S", value, REAL32)
        assert set_to.param_value == pytest.approx(value)
    everything = [own.parameters() for own in stations]
    assert everything[0] == everything[1] == everything[2]
    assert everything[0]["HOLD_S"][0] == pytest.approx(1.3)


def test_qgroundcontrols_handshake(on_the_floor: str, station: Callable[..., Any]) -> None:
    """The requests of QGroundControl's initial connection, in its order: each one is answered."""
    own = station("udpout:" + on_the_floor, system=255)
    heartbeat = own.answer("HEARTBEAT", fits=lambda m: m.get_srcComponent() == 1)
    assert heartbeat.type == own.mavlink.MAV_TYPE_QUADROTOR
    own.answer("AUTOPILOT_VERSION", lambda: own.command(REQUEST_MESSAGE, AUTOPILOT_VERSION))
    # AVAILABLE_MODES, COMPONENT_METADATA and COMPONENT_INFORMATION: it goes on at once where there are none.
    for number in (435, 397, 395):
        assert own.command(REQUEST_MESSAGE, number) in (DENIED, UNSUPPORTED)
    assert len(own.parameters()) > 80
    for kind in (0, 1, 2):
        own.answer(
            "MISSION_COUNT",
            lambda kind=kind: own.link.mav.mission_request_list_send(1, 1, kind),
            lambda m, kind=kind: m.mission_type == kind and m.count == 0,
        )
    own.answer("HOME_POSITION", lambda: own.command(REQUEST_MESSAGE, HOME_POSITION))
    assert own.command(SET_INTERVAL, HOME_POSITION, 1_000_000) == ACCEPTED
