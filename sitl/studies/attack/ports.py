"""Attacks on the port of a served vehicle, in real time: many clients, slow readers, paths that climb."""

from __future__ import annotations

import contextlib
import json
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from random import Random
from typing import Any

from trimtab.host.vehicle import load_vehicle
from trimtab.protocol import messages as m
from trimtab.protocol.codec import Codec
from trimtab.protocol.ftp import Opcode, Packet
from trimtab.sitl.studies.attack.flights import there_and_back
from trimtab.sitl.studies.attack.stranger import ADDRESS
from trimtab.sitl.vehicle import SimulatedVehicle

CROWDS = {"nine clients": 9, "a hundred clients": 100, "twenty clients that read nothing": 20}
"""Clients that join a flight, by their name in the study."""
FILES = ("ref/live.ref", "ref/staged.ref", "ff/live.ff", "ff/staged.ff")
_PIECES = (
    "..",
    ".",
    "",
    "ref",
    "ff",
    "etc",
    "passwd",
    "live.ref",
    "staged.ff",
    "~",
    "%2e%2e",
    "\\..",
    "C:",
    "\0",
)
_STEP_US = 10_000


def _run(*words: str) -> list[str]:
    return [sys.executable, "-m", "trimtab.host.cli", *words]


def _free_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


@contextlib.contextmanager
def _served(mocap: str) -> Iterator[tuple[str, int]]:
    """Serve a vehicle on a TCP port of this machine; yield host and port."""
    process = subprocess.Popen(
        _run("sitl", "--port", "tcp:127.0.0.1:0", "--mocap", mocap), stdout=subprocess.PIPE, text=True
    )
    assert process.stdout is not None
    try:
        host, _, port = process.stdout.readline().strip().removeprefix("tcp:").rpartition(":")
        yield host, int(port)
    finally:
        process.send_signal(signal.SIGINT)
        process.communicate()


def crowd(name: str, folder: Path) -> dict[str, Any]:
    """Fly over TCP while a crowd of clients joins, and return how the flight ended.

    The clients of "read nothing" connect with a small receive buffer and never read. The others send a
    heartbeat each and leave their data unread too.
    """
    folder.mkdir(parents=True, exist_ok=True)
    vehicle, mocap = load_vehicle("research"), f"udp://127.0.0.1:{_free_port()}"
    reference, log = folder / "there-and-back.ref", folder / f"{name.replace(' ', '-')}.mcap"
    reference.write_bytes(there_and_back(vehicle.id).to_bytes())
    log.unlink(missing_ok=True)
    with _served(mocap) as (host, port), contextlib.ExitStack() as stack:
        url = f"tcp:{host}:{port}"
        subprocess.run(_run("upload", str(reference), "--port", url), check=True, capture_output=True)
        fly = subprocess.Popen(
            _run("fly", str(reference), "--port", url, "--mocap", mocap, "-o", str(log), "--json"),
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        watcher = stack.enter_context(socket.create_connection((host, port)))
        _wait_until_armed(watcher)
        for number in range(CROWDS[name]):
            client = stack.enter_context(socket.socket(socket.AF_INET, socket.SOCK_STREAM))
            client.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
            client.connect((host, port))
            if "nothing" not in name:
                with contextlib.suppress(OSError):  # the server may have dropped it already
                    client.sendall(Codec(1 + number % 250, 190).encode(m.Timesync(0, number)))
        printed, _ = fly.communicate()
    answer = json.loads(printed.strip().splitlines()[-1])
    return {
        "crowd": name,
        "clients": CROWDS[name],
        "flown": bool(answer.get("whole")),
        "failsafe": answer.get("failsafe"),
        "tracking_rmse_m": answer.get("tracking_rmse_m"),
        "error": answer.get("error"),
    }


def _wait_until_armed(watcher: socket.socket) -> None:
    codec = Codec(*ADDRESS)
    while True:
        data = watcher.recv(4096)
        if not data:
            return
        for message in codec.decode(data):
            if isinstance(message, m.FcStatus) and message.state > m.mavlink.TRIMTAB_STATE_ARMED:
                return


def climbing_path(rng: Random) -> str:
    """Return a path that may lead out of the vehicle's folders, or to a file that does not exist."""
    pieces = [rng.choice(_PIECES) for _ in range(rng.randrange(1, 9))]
    return ("/" if rng.random() < 0.7 else "") + "/".join(pieces)


def climb(count: int, seed: int) -> dict[str, Any]:
    """Open `count` climbing paths by MAVLink FTP, and return how many were opened that are no files."""
    rng, codec = Random(f"{seed} paths"), Codec(*ADDRESS)
    vehicle = SimulatedVehicle.create(load_vehicle("research"), flight=seed)
    sent: dict[int, str] = {}
    opened, answered = [], 0
    number = 0
    while answered < count:
        if number < 4 * count:
            number += 1
            path = climbing_path(rng)
            sent[number & 0xFFFF] = path
            request = Packet(
                number=number & 0xFFFF,
                session=number % 8,
                opcode=rng.choice((Opcode.OPEN_FILE_RO, Opcode.CREATE_FILE, Opcode.REMOVE_FILE)),
                size=len(path),
                offset=0,
                data=path.encode("latin-1"),
            )
            vehicle.serial_write(codec.encode(m.FileTransfer(0, *m.VEHICLE, request.encode())))
        end_us = vehicle.now_us + _STEP_US
        while vehicle.now_us < end_us:
            vehicle.run_until(end_us)
            for message in codec.decode(vehicle.serial_read()):
                if isinstance(message, m.FileTransfer):
                    answer = Packet.decode(bytes(message.payload))
                    answered += 1
                    path = sent.get((answer.number - 1) & 0xFFFF, "")
                    name = path.partition("\0")[0].lstrip("/")
                    if answer.opcode == Opcode.ACK and name not in FILES:
                        opened.append(path)
            vehicle.mocap_read()
    return {"paths": answered, "opened": opened}
