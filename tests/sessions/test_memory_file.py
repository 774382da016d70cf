"""A vehicle's process that is killed in the middle of an upload, and the next one on the same memory."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from trimtab.firmware_model.storage.flash import Flash
from trimtab.firmware_model.storage.store import ReferenceStore
from trimtab.host.vehicle import Vehicle
from trimtab.protocol.blobs import Kind, Reference
from trimtab.protocol.upload.transfer import chunk_count

pytestmark = pytest.mark.realtime
TRIMTAB = (sys.executable, "-m", "trimtab.host.cli")
CLEAN = "tolerances = false\n[radio]\nloss = 0.0\n"


@contextmanager
def killed_at_the_end(*words: str) -> Iterator[tuple[subprocess.Popen[str], str]]:
    """`trimtab` in a process of its own and the first line it prints; SIGKILL ends it."""
    process = subprocess.Popen((*TRIMTAB, *words), stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    try:
        yield process, process.stdout.readline().strip()
    finally:
        process.kill()
        process.communicate()


def memory_in(path: Path) -> ReferenceStore:
    return ReferenceStore(Flash(bytearray(path.read_bytes())))


def held_in(path: Path) -> int:
    incoming = memory_in(path).incoming()
    return 0 if incoming is None else sum(incoming.held)


def test_killed_vehicle_started_again_on_its_memory_takes_the_rest_of_the_upload(
    vehicle: Vehicle, figure_eight: Callable[..., Reference], tmp_path: Path
) -> None:
    memory, world, wanted = tmp_path / "vehicle.memory", tmp_path / "clean.toml", tmp_path / "wanted.ref"
    world.write_text(f'description = "no frame is lost"\n{CLEAN}')
    reference = figure_eight(vehicle, duration_s=40.0)
    wanted.write_bytes(reference.to_bytes())
    chunks = chunk_count(len(reference.to_bytes()))
    sitl = ("sitl", "--port", "tcp:127.0.0.1:0", "--world", str(world), "--memory", str(memory))
    with killed_at_the_end(*sitl) as (_, port):
        command = (*TRIMTAB, "upload", str(wanted), "--port", port)
        uploader = subprocess.Popen(command, stdout=subprocess.DEVNULL)
        try:
            while held_in(memory) < chunks // 3:
                assert uploader.poll() is None
        finally:
            uploader.kill()
            uploader.wait()
    held = held_in(memory)
    assert chunks // 3 <= held < chunks
    assert memory_in(memory).live(Kind.REFERENCE) is None
    sent = []
    for _ in range(2):
        with killed_at_the_end(*sitl) as (_, port):
            command = (*TRIMTAB, "upload", str(wanted), "--port", port, "--json")
            said = subprocess.run(command, capture_output=True, text=True, check=True).stdout
            sent.append(json.loads(said.strip().splitlines()[-1]))
        assert memory_in(memory).live(Kind.REFERENCE) == reference.to_bytes()
    assert chunks - held <= sent[0]["frames_sent"] < chunks
    assert sent[1]["frames_sent"] < 10  # it is live already: only the question goes out
