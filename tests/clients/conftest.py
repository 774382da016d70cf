"""`trimtab sitl` in a process of its own, `trimtab poses` beside it, and the reference that clients fly."""

# pyright: reportMissingImports=false
# MAVSDK is of the extra `clients`.

from __future__ import annotations

import hashlib
import os
import shutil
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import pytest

from tests.clients.mavsdk_vehicle import Watched
from trimtab.protocol.codec import decode_message
from trimtab.protocol.messages import HOST_RADIO, VEHICLE_RADIO, RadioStats

os.environ["MAVLINK20"] = "1"  # pymavlink reads it when a connection is made

MAV_TYPE_GCS = 6
MAV_AUTOPILOT_INVALID = 8
ARMED = 128  # MAV_MODE_FLAG_SAFETY_ARMED
ACCEPTED = 0
ARM_DISARM, MISSION_START, SET_MESSAGE_INTERVAL = 400, 300, 511
TAKEOFF, LAND = 22, 21
LOCAL_POSITION_NED = 32

ROUTE = """name = "hop"
description = "Half a metre north and back"
total_time_s = 5.0
waypoints_m = [[0.0, 0.0, -1.2], [0.6, 0.0, -1.2], [0.0, 0.0, -1.2]]
"""
NORTH_M, DOWN_M = 0.6, -1.2
"""How far the reference goes, and where it stays."""


def run(*words: str) -> list[str]:
    """A verb of trimtab as a command line."""
    return [sys.executable, "-m", "trimtab.host.cli", *words]


@pytest.fixture(scope="session")
def reference_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A reference of 5 s, planned as a user would."""
    folder = tmp_path_factory.mktemp("reference")
    (folder / "hop.toml").write_text(ROUTE)
    subprocess.run(run("plan", "hop.toml", "-o", "hop.ref"), cwd=folder, check=True, capture_output=True)
    return folder / "hop.ref"


def commit_words(file: Path) -> tuple[int, int, int]:
    """The first 12 hex digits of a file's SHA-256 as MAV_CMD_USER_1 wants them: three 16-bit numbers."""
    digits = hashlib.sha256(file.read_bytes()).hexdigest()[:12]
    return int(digits[0:4], 16), int(digits[4:8], 16), int(digits[8:12], 16)


@pytest.fixture(scope="session", name="commit_words")
def _commit_words() -> Callable[[Path], tuple[int, int, int]]:
    return commit_words


def free_url() -> str:
    """A UDP port that nobody uses."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        return f"udp://127.0.0.1:{probe.getsockname()[1]}"


@contextmanager
def staying(*words: str) -> Iterator[str]:
    """First line of a verb that stays, in a process of its own; it has to end well when told to."""
    process = subprocess.Popen(run(*words), stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    try:
        said = process.stdout.readline().strip()
        assert said, "it ended before it said anything"
        yield said
        process.send_signal(signal.SIGTERM)
        process.communicate(timeout=60)
        assert process.returncode == 0
    finally:
        if process.poll() is None:
            process.kill()
            process.communicate()


@contextmanager
def serving() -> Iterator[Callable[..., str]]:
    """Start simulated vehicles that stay until the end of the context: what the fixture `serve` gives."""
    with ExitStack() as stack:

        def start(
            port: str = "udp:127.0.0.1:0", *, sitl: Sequence[str] = (), poses: Sequence[str] = ()
        ) -> str:
            mocap = free_url()
            address = stack.enter_context(staying("sitl", "--port", port, "--mocap", mocap, *sitl))
            if address.startswith("udp:"):
                said = stack.enter_context(staying("poses", "--port", address, "--mocap", mocap, *poses))
                assert said.startswith("forwarding poses")
            return address.removeprefix("udp:").removeprefix("tcp:")

        yield start


@pytest.fixture
def serve() -> Iterator[Callable[..., str]]:
    """Starts a simulated vehicle: serve("udp:127.0.0.1:0") -> the address, HOST:PORT or a device.

    `sitl` and `poses` are further options of the two verbs.

    Over UDP, `trimtab poses` forwards the camera system's poses to the same port.
    """
    with serving() as start:
        yield start


@pytest.fixture(scope="module")
def on_the_floor() -> Iterator[str]:
    """The UDP address of a vehicle that the last tests of a module share: it never arms."""
    with serving() as start:
        yield start()


@pytest.fixture(scope="session")
def key_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A new key, as `trimtab key new` makes it."""
    path = tmp_path_factory.mktemp("key") / "lab.key"
    subprocess.run(run("key", "new", str(path)), check=True, capture_output=True)
    return path


@pytest.fixture(scope="session")
def memory_with_key(key_file: Path) -> Path:
    """What a vehicle remembers after the key was installed by cable."""
    memory = key_file.parent / "vehicle.memory"
    with staying("sitl", "--port", "pty", "--world", "wired", "--memory", str(memory)) as device:
        install = run("key", "install", str(key_file), "--port", device)
        subprocess.run(install, check=True, capture_output=True)
    return memory


@pytest.fixture
def serve_with_key(
    serve: Callable[..., str], key_file: Path, memory_with_key: Path, tmp_path: Path
) -> Callable[..., str]:
    """Like `serve`, over the radio, after the key was installed by cable."""

    def start(port: str = "udp:127.0.0.1:0") -> str:
        memory = shutil.copy(memory_with_key, tmp_path / "vehicle.memory")
        return serve(port, sitl=("--memory", str(memory)), poses=("--key", str(key_file)))

    return start


class Station:
    """A ground station of pymavlink's mavutil, with the stock dialect and no knowledge of Trimtab.

    It says a heartbeat every second and asks again where no answer comes, as every ground station does: the
    radio loses frames. Nothing here ends a wait but an answer, or the test's timeout.

    Attributes:
        texts: what the vehicle said. armed: whether its last heartbeat says so. track: LOCAL_POSITION_NED, as
        (north, east, down). radio_stats: the reports of the radios, by system.
    """

    def __init__(self, url: str, system: int = 252, **options: Any) -> None:
        from pymavlink import mavutil

        self.mavlink = mavutil.mavlink
        self.link = mavutil.mavlink_connection(
            url, dialect="common", source_system=system, source_component=190, **options
        )
        self.texts: list[str] = []
        self.track: list[tuple[float, float, float]] = []
        self.armed = False
        self.radio_stats: dict[int, list[tuple[float, RadioStats]]] = {}
        self._said_s = 0.0
        self.link.message_hooks.append(self._note)

    def _note(self, link: Any, message: Any) -> None:
        kind = message.get_type()
        if kind == f"UNKNOWN_{RadioStats.id}":
            stats = decode_message(bytes(message.get_msgbuf()))
            assert isinstance(stats, RadioStats)
            self.radio_stats.setdefault(stats.get_srcSystem(), []).append((time.monotonic(), stats))
        if message.get_srcSystem() != 1:
            return
        if kind == "STATUSTEXT":
            self.texts.append(message.text)
        elif kind == "HEARTBEAT" and message.get_srcComponent() == 1:
            self.armed = bool(message.base_mode & ARMED)
        elif kind == "LOCAL_POSITION_NED":
            self.track.append((message.x, message.y, message.z))

    def step(self, kind: str | list[str] | None = None, wait_s: float = 0.1) -> Any:
        """The next message of that kind, None where none came in time."""
        if time.monotonic() - self._said_s > 1.0:
            self._said_s = time.monotonic()
            self.link.mav.heartbeat_send(MAV_TYPE_GCS, MAV_AUTOPILOT_INVALID, 0, 0, 0)
        return self.link.recv_match(type=kind, blocking=True, timeout=wait_s)

    def until(self, condition: Callable[[], bool]) -> None:
        """Listens until the condition holds."""
        while not condition():
            self.step()

    def answer(
        self, kind: str, ask: Callable[[], None] = lambda: None, fits: Callable[[Any], bool] = lambda m: True
    ) -> Any:
        """The first fitting message of that kind; `ask` is called again every second.

        What had come before it was asked is no answer.
        """
        while self.link.recv_match() is not None:
            pass
        while True:
            ask()
            again_s = time.monotonic() + 1.0
            while time.monotonic() < again_s:
                message = self.step(kind)
                if message is not None and message.get_srcSystem() == 1 and fits(message):
                    return message

    def _ack(self, number: int, ask: Callable[[], None]) -> int:
        own = self.link.mav.srcSystem
        found = self.answer("COMMAND_ACK", ask, lambda m: m.command == number and m.target_system in (0, own))
        return found.result

    def command(self, number: int, *words: float) -> int:
        """MAV_RESULT of a COMMAND_LONG."""
        values = (*words, *(0.0,) * (7 - len(words)))
        return self._ack(number, lambda: self.link.mav.command_long_send(1, 1, number, 0, *values))

    def command_int(self, number: int, *words: float) -> int:
        """MAV_RESULT of a COMMAND_INT, of param1 to param4."""
        values = (*words, *(0.0,) * (4 - len(words)))
        return self._ack(
            number, lambda: self.link.mav.command_int_send(1, 1, 1, number, 0, 0, *values, 0, 0, 0.0)
        )

    def parameters(self) -> dict[str, tuple[float, int]]:
        """Every parameter: its value as it travels, and its type."""
        found: dict[int, Any] = {}
        count = self.answer("PARAM_VALUE", lambda: self.link.mav.param_request_list_send(1, 1)).param_count
        while len(found) < count:
            message = self.step("PARAM_VALUE", 1.0)
            if message is None:
                missing = min(set(range(count)) - set(found))
                self.link.mav.param_request_read_send(1, 1, b"", missing)
            elif message.param_index < count:
                found[message.param_index] = message
        return {m.param_id: (m.param_value, m.param_type) for m in found.values()}

    def set_parameter(self, name: str, value: float, kind: int) -> Any:
        """The PARAM_VALUE that answers."""
        return self.answer(
            "PARAM_VALUE",
            lambda: self.link.mav.param_set_send(1, 1, name.encode(), value, kind),
            lambda m: m.param_id == name,
        )

    def arm(self) -> None:
        """Arms as soon as the vehicle lets it: the gyro is calibrated and poses have come."""
        while self.command(ARM_DISARM, 1) != ACCEPTED:
            self.step(wait_s=1.0)
        self.until(lambda: self.armed)

    def fly(self) -> None:
        """Arms, starts the reference on board and watches until the vehicle has landed and disarmed."""
        self.arm()
        assert self.command(SET_MESSAGE_INTERVAL, LOCAL_POSITION_NED, 50_000) == ACCEPTED
        assert self.command(MISSION_START) == ACCEPTED
        self.until(lambda: not self.armed)

    def take_off_and_land(self) -> None:
        """Takes off to 1 m, lands, and watches until the vehicle has disarmed. It has to be armed."""
        assert self.command(SET_MESSAGE_INTERVAL, LOCAL_POSITION_NED, 50_000) == ACCEPTED
        assert self.command(TAKEOFF, 0, 0, 0, 0, 0, 0, 1.0) == ACCEPTED
        self.until(lambda: bool(self.track) and self.track[-1][2] < -0.9)
        assert self.command(LAND) == ACCEPTED
        self.until(lambda: not self.armed)

    def downlink_loss(self) -> float:
        """Share of the frames from the vehicle's radio to the ground radio that was lost, of all so far."""
        came_s, sent = self.radio_stats[VEHICLE_RADIO[0]][-1]
        # Both radios report at the same second; the vehicle's report may be lost.
        _, received = min(self.radio_stats[HOST_RADIO[0]], key=lambda row: abs(row[0] - came_s))
        return 1.0 - received.frames_received / sent.frames_sent

    def close(self) -> None:
        self.link.close()


def flown(track: Sequence[tuple[float, float, float]]) -> bool:
    """Whether a track is that of the reference: north and back, at its height, from floor to floor."""
    north, _, down = zip(*track, strict=True)
    return (
        max(north) == pytest.approx(NORTH_M, abs=0.1)
        and min(down) == pytest.approx(DOWN_M, abs=0.15)
        and track[-1] == pytest.approx((0.0, 0.0, 0.0), abs=0.2)
    )


@pytest.fixture(scope="session", name="flown")
def _flown() -> Callable[[Sequence[tuple[float, float, float]]], bool]:
    return flown


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


@pytest.fixture
def station() -> Iterator[Callable[..., Station]]:
    """Opens ground stations: station("udpout:HOST:PORT")."""
    with ExitStack() as stack:

        def start(url: str, **options: Any) -> Station:
            opened = Station(url, **options)
            stack.callback(opened.close)
            return opened

        yield start
