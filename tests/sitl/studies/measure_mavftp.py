"""pymavlink's mavftp puts the blob of the study of the link over the same air: `python FILE SEED RUNS`.

The client is the real one, its clock and its connection are the simulation's. Time counts from its first
message until the file is staged on board; what its user would do anew, is done anew. A commit comes on top.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path
from types import SimpleNamespace
from typing import Any

from pymavlink import mavftp

from trimtab.protocol.blobs import Kind
from trimtab.protocol.messages import HOST, FileTransfer, Message
from trimtab.sitl.studies.upload_blob import reference_blob
from trimtab.sitl.studies.upload_rig import UploadRig
from trimtab.sitl.studies.uploads import CHANNELS, percentile

TICK_US = 1_000
GIVE_UP_US = 300_000_000


class Line:
    """In the sender's place in the rig: what mavftp says goes out, what comes for it waits."""

    over = False

    def __init__(self) -> None:
        self.out: list[Message] = []
        self.heard: list[Message] = []
        self._now_us = 0

    def receive(self, message: Message, now_us: int) -> bool:
        if isinstance(message, FileTransfer):
            self.heard.append(message)
        return True

    def advance(self, now_us: int) -> None:
        self._now_us = now_us

    def send(self, now_us: int) -> list[Message]:
        out, self.out = self.out, []
        return out

    def next_deadline_us(self) -> int:
        return self._now_us + TICK_US


class Master:
    """The part of a mavutil connection that mavftp uses, in the rig's time."""

    source_system, source_component = HOST

    def __init__(self, rig: UploadRig, line: Line) -> None:
        self._rig, self._line = rig, line
        self.mav = self

    def file_transfer_protocol_send(self, network: int, system: int, component: int, payload: bytes) -> None:
        self._line.out.append(FileTransfer(network, system, component, bytes(payload)))

    def recv_match(self, type: Any = None, timeout: float = 0.0, blocking: bool = True) -> Message | None:
        until_us = self._rig.now_us + round(timeout * 1e6)
        while not self._line.heard and self._rig.now_us < until_us:
            self._rig.step(until_us)
        return self._line.heard.pop(0) if self._line.heard else None


def put(seed: int, number: int, settings: dict[str, int]) -> tuple[float, int]:
    """Seconds until the file is staged, and how often the put was begun."""
    line = Line()
    make: Any = lambda blob: line  # noqa: E731
    rig = UploadRig(
        reference_blob("research", 1),
        old=reference_blob("research", 0),
        radio=CHANNELS["upload"],
        seed=seed,
        number=number,
        make_sender=make,
    )
    rig.run(rig.begin_us)
    setattr(mavftp, "time", SimpleNamespace(time=lambda: rig.now_us * 1e-6))  # noqa: B010
    client = mavftp.MAVFTP(Master(rig, line), 1, 1)
    for name, value in settings.items():
        setattr(client.ftp_settings, name, value)
    begun_us, begun = rig.now_us, 0
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "new.ref"
        file.write_bytes(rig.blob)
        while rig.vehicle.store.staged(Kind.REFERENCE) != rig.blob:
            if rig.now_us > GIVE_UP_US:
                raise TimeoutError(f"run {number}: not there after {GIVE_UP_US * 1e-6:g} s")
            begun += 1
            client.cmd_put([str(file), "/ref/staged.ref"])
            client.process_ftp_reply("put", timeout=60)
    return (rig.now_us - begun_us) * 1e-6, begun


def main(seed: int, runs: int) -> None:
    """Prints mean and 99th percentile, for mavftp as it comes and with messages of full length."""
    for name, settings in (
        ("as it comes (80 B, 5 under way)", {}),
        ("239 B, one under way", {"write_size": 239, "write_qsize": 1}),
        ("239 B, 5 under way", {"write_size": 239}),
    ):
        found = [put(seed, number, settings) for number in range(runs)]
        times = [seconds for seconds, _ in found]
        mean_s, p99_s = sum(times) / runs, percentile(times, 0.99)
        again = sum(begun for _, begun in found) - runs
        print(f"mavftp, {name}: {runs} runs, mean {mean_s:.3g} s, p99 {p99_s:.3g} s, {again} begun anew")


if __name__ == "__main__":
    main(int(sys.argv[1]), int(sys.argv[2]))
