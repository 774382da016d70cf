"""`trimtab watch` on flown logs: figures, a log that grows, and a viewer at the port."""

from __future__ import annotations

import base64
import json
import os
import shutil
import socket
import struct
import sys
from collections.abc import Callable, Iterator
from contextlib import closing
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest

from trimtab.host.base.parts import part_path
from trimtab.host.link.summary import FlightResult
from trimtab.host.log import Flight
from trimtab.host.log.follow import LogFollower
from trimtab.host.log.scan import Scan
from trimtab.host.log.tracking import tracking_error
from trimtab.host.watch.server import HOST, ViewerServer
from trimtab.host.watch.watch import watch

TEXT, BINARY, PING, PONG = 1, 2, 9, 10


def test_figures_grow_with_the_log_and_end_as_the_flight_did(
    flown: tuple[FlightResult, Flight], tmp_path: Path
) -> None:
    target, log = tmp_path / "growing.mcap", flown[0].log.read_bytes()
    seen: list[dict[str, Any]] = []
    idle: list[int] = []
    pieces = iter([log[k : k + 50_000] for k in range(0, len(log), 50_000)])

    def write_more() -> None:
        with part_path(target).open("ab") as file:
            file.write(next(pieces))

    def note(figures: dict[str, Any], looks: int) -> None:
        seen.append(figures)
        idle.append(looks)

    last = watch(target, wait=write_more, on_figures=note)
    assert seen[-1] == last
    assert seen[0]["phase"] is None
    assert idle[0] == 1  # nothing was there yet
    times = [each["time_s"] for each in seen]
    grew = [b > a for a, b in pairwise(times)]
    assert [looks == 0 for looks in idle[1:]] == grew
    assert times == sorted(times)
    assert len(set(times)) > 5
    phases = list(dict.fromkeys(each["phase"] for each in seen if each["phase"] is not None))
    assert phases[-1] == "standby"
    assert {"tracking", "landing"} <= {*phases}
    error = tracking_error(flown[1])
    assert error is not None
    # Rows of the log are 10 ms apart, and the hold after the tracking phase counts too.
    assert last["error_max_m"] == pytest.approx(error.max_m, rel=0.02)
    assert (last["failsafe"], last["battery_v"]) == (None, pytest.approx(16.8, abs=0.1))
    assert 5.0 < last["pose_age_ms"] < 60.0
    assert 5.0 < last["rtt_ms"] < 60.0
    assert 0.0 <= last["frames_lost_share"] < 0.05


def test_verb_shows_a_closed_log_and_ends(
    run_trimtab: Callable[..., tuple[int, dict[str, Any], str]],
    flown: tuple[FlightResult, Flight],
    tmp_path: Path,
) -> None:
    shutil.copy(flown[0].log, tmp_path / "flight.mcap")
    code, told, complaint = run_trimtab("watch", "flight.mcap", "--json")
    assert (code, told["phase"], told["port"], complaint) == (0, "standby", None, "")
    (tmp_path / "x.mcap").write_bytes(b"no log of anything")
    code, told, complaint = run_trimtab("watch", "x.mcap", "--json")
    assert (code, told["exit_code"], len(complaint.strip().splitlines())) == (5, 5, 1)


class Viewer:
    """A client of Foxglove's WebSocket protocol, without foxglove-sdk."""

    def __init__(self, port: int) -> None:
        self._socket = socket.create_connection((HOST, port), timeout=60.0)
        self._stream = self._socket.makefile("rb")
        key = base64.b64encode(os.urandom(16)).decode()
        self._socket.sendall(
            f"GET / HTTP/1.1\r\nHost: {HOST}:{port}\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
            f"Sec-WebSocket-Key: {key}\r\nSec-WebSocket-Version: 13\r\n"
            "Sec-WebSocket-Protocol: foxglove.sdk.v1\r\n\r\n".encode()
        )
        assert b" 101 " in self._stream.readline()
        while self._stream.readline() != b"\r\n":
            pass

    def send(self, opcode: int, data: bytes) -> None:
        assert len(data) < 2**16
        head = struct.pack(">BB", 0x80 | opcode, 0x80 | min(len(data), 126))
        self._socket.sendall(
            head + (struct.pack(">H", len(data)) if len(data) > 125 else b"") + bytes(4) + data
        )

    def frames(self) -> Iterator[tuple[int, bytes]]:
        while True:
            opcode, size = self._stream.read(2)
            if size == 126:
                (size,) = struct.unpack(">H", self._stream.read(2))
            elif size == 127:
                (size,) = struct.unpack(">Q", self._stream.read(8))
            yield opcode & 0x0F, self._stream.read(size)

    def advertised(self, topics: set[str]) -> dict[str, dict[str, Any]]:
        """The channels of these topics, once all of them are advertised."""
        channels: dict[str, dict[str, Any]] = {}
        for opcode, data in self.frames():
            if opcode == TEXT and (told := json.loads(data))["op"] == "advertise":
                channels |= {channel["topic"]: channel for channel in told["channels"]}
            if topics <= set(channels):
                break
        return channels

    def subscribe(self, channels: list[int]) -> None:
        """Subscribe to channels, under their own numbers. Return when the server knows."""
        wanted = [{"id": number, "channelId": number} for number in channels]
        self.send(TEXT, json.dumps({"op": "subscribe", "subscriptions": wanted}).encode())
        self.send(PING, b"")
        next(data for opcode, data in self.frames() if opcode == PONG)

    def messages(self, count: int) -> list[tuple[int, int, bytes]]:
        """Subscription, time (ns) and data of the next messages."""
        found = []
        for opcode, data in self.frames():
            if opcode == BINARY and data[0] == 1:
                found.append((*struct.unpack_from("<IQ", data, 1), data[13:]))
            if len(found) == count:
                return found
        raise AssertionError("the server has gone")

    def close(self) -> None:
        self._stream.close()
        self._socket.close()


def first_and_rest(log: Path) -> tuple[Scan, list[Any], list[Any]]:
    """Content of a log, its messages of the first second, and the next hundred."""
    with LogFollower(log) as follower:
        messages = follower.poll()
    first = [each for each in messages if each.log_time_us < 1_000_000]
    later = [each for each in messages if each.log_time_us >= 1_000_000]
    return follower.content, first, later[:100]


@pytest.mark.full  # foxglove-sdk
def test_viewer_that_connects_in_flight_gets_what_is_flown_and_the_vehicle(
    require: Callable[[str], None], flown: tuple[FlightResult, Flight]
) -> None:
    require("watch")
    content, first, later = first_and_rest(flown[0].log)
    topics = {channel.topic: number for number, channel in content.channels.items()}
    with closing(ViewerServer(0)) as server:
        server.send(content, first)
        with closing(Viewer(server.port)) as viewer:
            wanted = ("/display/vehicle", "/mocap/pose")
            channels = viewer.advertised({*wanted})
            assert channels["/display/vehicle"]["schemaName"] == "foxglove.SceneUpdate"
            assert channels["/mocap/pose"]["encoding"] == "protobuf"
            schema = content.schemas[content.channels[topics["/mocap/pose"]].schema_id]
            padded = channels["/mocap/pose"]["schema"] + "=="
            assert base64.b64decode(padded) == schema.data
            viewer.subscribe([channels[topic]["id"] for topic in wanted])
            server.send(content, later)
            poses = [each for each in later if each.channel_id == topics["/mocap/pose"]]
            (vehicle,) = (each for each in first if each.channel_id == topics["/display/vehicle"])
            found = viewer.messages(len(poses) + 1)
    numbers = [channels[topic]["id"] for topic in wanted]
    assert [each for each in found if each[0] == numbers[0]] == [(numbers[0], 0, vehicle.data)]
    expected = [(numbers[1], 1000 * each.log_time_us, each.data) for each in poses]
    assert [each for each in found if each[0] == numbers[1]] == expected


@pytest.mark.full  # foxglove-sdk
def test_verb_serves_a_port_and_refuses_one_that_is_taken(
    require: Callable[[str], None],
    run_trimtab: Callable[..., tuple[int, dict[str, Any], str]],
    flown: tuple[FlightResult, Flight],
) -> None:
    require("watch")
    code, told, _ = run_trimtab("watch", str(flown[0].log), "--port", "0", "--json")
    assert code == 0
    assert told["port"] > 0
    with socket.create_server((HOST, 0)) as taken:
        port = str(taken.getsockname()[1])
        code, _, complaint = run_trimtab("watch", str(flown[0].log), "--port", port, "--json")
    assert (code, len(complaint.strip().splitlines())) == (2, 1)
    assert f"--port {port}" in complaint


def test_verb_without_the_library_names_the_extra(
    monkeypatch: pytest.MonkeyPatch,
    run_trimtab: Callable[..., tuple[int, dict[str, Any], str]],
    flown: tuple[FlightResult, Flight],
) -> None:
    monkeypatch.setitem(sys.modules, "foxglove", None)
    code, _, complaint = run_trimtab("watch", str(flown[0].log), "--port", "0")
    assert code == 2
    assert "foxglove-sdk" in complaint
