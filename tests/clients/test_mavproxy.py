"""MAVProxy's console, fed through its standard input, from the first parameter to the landing."""

from __future__ import annotations

import os
import queue
import re
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

pytestmark = [pytest.mark.full, pytest.mark.realtime]

AGAIN_S = 10.0


class Console:
    """MAVProxy as a person has it before them: commands in, lines out. `said` is every line so far."""

    def __init__(self, process: subprocess.Popen[str]) -> None:
        self.said: list[str] = []
        self._process = process
        self._lines: queue.Queue[str] = queue.Queue()
        threading.Thread(target=self._listen, daemon=True).start()

    def _listen(self) -> None:
        assert self._process.stdout is not None
        for line in self._process.stdout:
            self._lines.put(line.rstrip())

    def type(self, command: str) -> None:
        assert self._process.stdin is not None
        self._process.stdin.write(command + "\n")
        self._process.stdin.flush()

    def until(self, text: str, command: str | None = None) -> str:
        """The next line with that text; the command is typed before, and again where nothing comes of it."""
        if command is not None:
            self.type(command)
        while True:
            try:
                line = self._lines.get(timeout=AGAIN_S)
            except queue.Empty:
                assert self._process.poll() is None, "MAVProxy has ended"
                if command is not None:
                    self.type(command)
                continue
            self.said.append(line)
            print(line)  # shown where the test fails
            if text in line:
                return line


@contextmanager
def mavproxy(address: str, folder: Path, dialect: str = "common") -> Iterator[Console]:
    process = subprocess.Popen(
        [
            *(sys.executable, "-m", "MAVProxy.mavproxy", f"--master=udpout:{address}"),
            *(f"--dialect={dialect}", "--mav20", "--state-basedir=."),
        ],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        cwd=folder,
        env={**os.environ, "PYTHONUNBUFFERED": "1", "HOME": str(folder), "MPLBACKEND": "agg"},
    )
    try:
        yield Console(process)
    finally:
        process.kill()
        process.communicate()


def test_mavproxy_uploads_commits_flies_and_reads_back(
    serve: Callable[..., str],
    station: Callable[..., Any],
    require: Callable[[str], None],
    reference_file: Path,
    commit_words: Callable[[Path], tuple[int, int, int]],
    flown: Callable[[Any], bool],
    tmp_path: Path,
) -> None:
    require("clients")
    data = reference_file.read_bytes()
    size = f"live.ref\t{len(data)}"
    address = serve()
    beside = station(f"udpout:{address}")  # a second station, which sees what MAVProxy brings about
    beside.answer("HEARTBEAT")
    with mavproxy(address, tmp_path) as console:
        console.until(" parameters to ./mav.parm")
        console.until("1.5", "param set HOLD_S 1.5\nparam show HOLD_S")
        console.until("start refused", "long MISSION_START 0 0 0 0 0 0 0")

        console.until("staged.ref accepted", f"ftp put {reference_file} /ref/staged.ref")
        first, second, third = commit_words(reference_file)
        console.until("USER_1: ACCEPTED", f"long USER_1 {first} {second} {third} 0 0 0 0")
        console.until(size, "ftp list /ref")
        console.until(f"Wrote {len(data)} bytes", "ftp get /ref/live.ref back.ref")
        console.until("crc: /ref/live.ref", "ftp crc /ref/live.ref")  # by then the file is closed
        assert (tmp_path / "back.ref").read_bytes() == data

        console.until("COMPONENT_ARM_DISARM: ACCEPTED", "arm throttle")
        beside.until(lambda: beside.armed)
        console.until("MISSION_START: ACCEPTED", "long MISSION_START 0 0 0 0 0 0 0")
        beside.until(lambda: not beside.armed)
        console.until("DISARMED")
        shown = re.search(r"([\d.]+)% loss", console.until("% loss", "link"))
        assert shown is not None
        # MAVProxy counts some 900 messages, of which bursts lose 6 +- 6; one overtaken message adds 27 %.
        assert float(shown[1]) == pytest.approx(100.0 * beside.downlink_loss(), abs=3.0)
    assert flown(beside.track)
    assert beside.parameters()["HOLD_S"][0] == 1.5
    assert not any("breach" in line for line in console.said)


def test_mavproxy_sets_a_whole_number(
    serve: Callable[..., str], station: Callable[..., Any], require: Callable[[str], None], tmp_path: Path
) -> None:
    """MAVProxy sends every number as a float to vehicles that are not PX4's."""
    require("clients")
    address = serve()
    beside = station(f"udpout:{address}")
    with mavproxy(address, tmp_path) as console:
        console.until(" parameters to ./mav.parm")
        console.type("param set BAT_CELLS 6")
        changed = beside.answer(
            "PARAM_VALUE",
            lambda: beside.link.mav.param_request_read_send(1, 1, b"BAT_CELLS", -1),
            lambda m: m.param_id == "BAT_CELLS" and m.param_value == BITS_OF_6,
        )
    assert changed.param_type == 6  # MAV_PARAM_TYPE_INT32


def test_mavproxy_lists_no_logs_and_lands_by_mode(
    serve: Callable[..., str], station: Callable[..., Any], require: Callable[[str], None], tmp_path: Path
) -> None:
    """MAVProxy names modes as an ArduCopter numbers them: LAND is 9; RTL, 6, is PX4's offboard."""
    require("clients")
    address = serve()
    beside = station(f"udpout:{address}")
    beside.answer("HEARTBEAT")
    with mavproxy(address, tmp_path) as console:
        console.until(" parameters to ./mav.parm")
        console.until("No logs", "log list")
        console.until("COMPONENT_ARM_DISARM: ACCEPTED", "arm throttle")
        console.until("NAV_TAKEOFF: ACCEPTED", "takeoff 1")
        beside.until(lambda: bool(beside.track) and beside.track[-1][2] < -0.9)
        console.until("offboard refused: no setpoints", "mode RTL")
        console.until("DO_SET_MODE: ACCEPTED", "mode LAND")
        beside.until(lambda: not beside.armed)


def test_mavproxy_with_the_key_flies_a_reference(
    serve_with_key: Callable[..., str],
    station: Callable[..., Any],
    require: Callable[[str], None],
    reference_file: Path,
    commit_words: Callable[[Path], tuple[int, int, int]],
    flown: Callable[[Any], bool],
    key_file: Path,
    tmp_path: Path,
) -> None:
    require("clients")
    address = serve_with_key()
    beside = station(f"udpout:{address}")  # without the key: it reads only
    beside.answer("HEARTBEAT")
    # With the dialect `common`, MAVProxy 1.8.75 fails at the first unsigned message.
    with mavproxy(address, tmp_path, dialect="ardupilotmega") as console:
        console.until("Setup signing key", f"signing key {key_file.read_text().strip()}")
        console.until(" parameters to ./mav.parm")
        console.until("1.5", "param set HOLD_S 1.5\nparam show HOLD_S")
        console.until("staged.ref accepted", f"ftp put {reference_file} /ref/staged.ref")
        first, second, third = commit_words(reference_file)
        console.until("USER_1: ACCEPTED", f"long USER_1 {first} {second} {third} 0 0 0 0")
        console.until("COMPONENT_ARM_DISARM: ACCEPTED", "arm throttle")
        beside.until(lambda: beside.armed)
        console.until("MISSION_START: ACCEPTED", "long MISSION_START 0 0 0 0 0 0 0")
        beside.until(lambda: not beside.armed)
    assert flown(beside.track)


def test_mavproxy_sets_up_the_key_by_cable(
    serve: Callable[..., str], require: Callable[[str], None], key_file: Path, tmp_path: Path
) -> None:
    require("clients")
    address = serve(sitl=("--world", "wired"))
    # The vehicle's last unsigned messages may come after the key: see above.
    with mavproxy(address, tmp_path, dialect="ardupilotmega") as console:
        console.until(" parameters to ./mav.parm")
        console.until("signing key installed", f"signing setup {key_file.read_text().strip()}")
        console.until("COMMAND_ACK: NAV_LAND", "long NAV_LAND 0 0 0 0 0 0 0")
        console.until("signing key removed", "signing remove")


BITS_OF_6 = 8.407790785948902e-45
"""The float whose bits are the int32 6."""
