"""What is on board comes back byte by byte, over clean and lossy air, and is told apart from what is not."""

from __future__ import annotations

import contextlib
import json
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from trimtab.host import cli
from trimtab.host.base.errors import LinkError, UsageError
from trimtab.host.link import download
from trimtab.host.link.download import PIECE_BYTES, download_lockstep
from trimtab.host.link.upload import upload_lockstep
from trimtab.host.vehicle import Vehicle
from trimtab.protocol import messages as m
from trimtab.protocol.blobs import NEUTRAL_BLOCK, FeedForward, Reference
from trimtab.protocol.codec import Codec
from trimtab.protocol.ftp import Opcode, Packet
from trimtab.protocol.uwb_pieces import FRAME_BYTES
from trimtab.sitl.serve import serve
from trimtab.sitl.vehicle import SimulatedVehicle


def simulated(vehicle: Vehicle, **options: Any) -> SimulatedVehicle:
    return SimulatedVehicle.create(vehicle, **options)


def test_piece_fills_a_radio_frame() -> None:
    answer = Packet(number=1, session=84, opcode=Opcode.ACK, size=PIECE_BYTES, data=b"\1" * PIECE_BYTES)
    assert len(Codec(*m.VEHICLE).encode(m.FileTransfer(0, *m.HOST, answer.encode()))) == FRAME_BYTES


@pytest.mark.parametrize("radio", [{}, {"loss": 0.25, "burst_frames": 5.0}])
def test_reference_and_feedforward_read_back_as_they_were_sent(
    vehicle: Vehicle, reference: Reference, radio: dict[str, float]
) -> None:
    board = simulated(vehicle, world_seed=41, radio=radio)
    addition = FeedForward(vehicle_id=vehicle.id, model_id="0" * 12, block=(1.02, *NEUTRAL_BLOCK[1:]))
    for blob, name in ((reference, "reference"), (addition, "feedforward")):
        assert upload_lockstep(blob, board, compare=True).read_back
        found = download_lockstep(name, board)
        assert (found.data, found.id) == (blob.to_bytes(), blob.id)
        assert bool(radio) or found.repeated == 0


def test_what_is_not_on_board_is_told(vehicle: Vehicle) -> None:
    board = simulated(vehicle)
    for name in download.NAMES:
        with pytest.raises(UsageError, match=f"vehicle: no {name} on board; send one with trimtab upload"):
            download_lockstep(name, board)


def test_bytes_that_make_another_id_are_refused(
    vehicle: Vehicle, reference: Reference, monkeypatch: pytest.MonkeyPatch
) -> None:
    board = simulated(vehicle)
    upload_lockstep(reference, board)
    damaged = bytearray(reference.to_bytes())
    damaged[100] ^= 1
    monkeypatch.setattr(board.store, "live", lambda kind: bytes(damaged))
    with pytest.raises(LinkError, match=f"expected reference {reference.id} but received"):
        download_lockstep("reference", board)


@contextlib.contextmanager
def served(board: SimulatedVehicle, port: str) -> Iterator[str]:
    """The vehicle at a port, in a thread."""
    stop, up = threading.Event(), threading.Event()
    found: list[str] = []

    def ready(address: str) -> None:
        found.append(address)
        up.set()

    thread = threading.Thread(
        target=lambda: serve(board, port=port, stop=stop.is_set, ready=ready), daemon=True
    )
    thread.start()
    up.wait()
    try:
        yield found[0]
    finally:
        stop.set()
        thread.join()


@pytest.mark.parametrize("port", ["udp:127.0.0.1:0", "tcp:127.0.0.1:0"])
def test_two_programs_download_at_the_same_time(
    vehicle: Vehicle, reference: Reference, port: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    board = simulated(vehicle)
    upload_lockstep(reference, board)
    results: list[download.Download] = []
    with served(board, port) as address:
        second = threading.Thread(target=lambda: results.append(download.download_port("reference", address)))
        second.start()
        target = tmp_path / "copy.ref"
        words = ["download", "reference", "--port", address, "-o", str(target), "--json"]
        assert cli.main(words) == 0
        second.join()
    assert results[0].data == target.read_bytes() == reference.to_bytes()
    told = json.loads(capsys.readouterr().out.strip().splitlines()[-1])
    assert (told["id"], told["bytes"]) == (reference.id, len(reference.to_bytes()))


def test_download_does_not_overwrite(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    target = tmp_path / "there.ref"
    target.write_text("mine")
    assert cli.main(["download", "reference", "--port", "/dev/null", "-o", str(target)]) == 2
    assert "exists; choose another name or add --force" in capsys.readouterr().err
    assert target.read_text() == "mine"
