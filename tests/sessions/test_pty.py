"""Two flights in real time over a real pseudo terminal, through pyserial, as in two shells."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from tests.rate_controller import RateController
from trimtab.host.link.flight_request import FlightRequest
from trimtab.host.link.fly import fly_port
from trimtab.host.link.host_control import HostControl
from trimtab.host.link.upload import upload_port
from trimtab.host.log import read_flight
from trimtab.host.log.provenance import is_simulated
from trimtab.host.vehicle import Vehicle
from trimtab.protocol.blobs import Reference
from trimtab.sitl.seeds import session_uid

pytestmark = pytest.mark.realtime


@pytest.fixture(autouse=True)
def _pty(require: Callable[[str], None]) -> None:
    require("pty")


@contextmanager
def served(*words: str) -> Iterator[tuple[str, Callable[[], dict]]]:
    """`trimtab sitl` in a process of its own: its port, and a function that ends it and gives its JSON."""
    command = [sys.executable, "-m", "trimtab.host.cli", "sitl", *words, "--json"]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None

    def end() -> dict:
        process.send_signal(signal.SIGTERM)
        said, _ = process.communicate(timeout=60)
        assert process.returncode == 0
        return json.loads(said.strip().splitlines()[-1])

    try:
        yield process.stdout.readline().strip(), end
    finally:
        if process.poll() is None:
            process.kill()
            process.communicate()


def test_pty_flight_after_upload_tracks_and_logs(
    vehicle: Vehicle, reference: Reference, mocap_url: str, tmp_path: Path
) -> None:
    truth = tmp_path / "truth.json"
    with served("--port", "pty", "--mocap", mocap_url, "--world-seed", "2", "--truth", str(truth)) as (
        port,
        end,
    ):
        uploaded = upload_port(reference, port)
        assert uploaded.id == reference.id
        again = upload_port(reference, port)  # it is live already: only the question goes out
        assert again.frames_sent < 10
        order = FlightRequest(
            vehicle=vehicle,
            reference=reference,
            log_path=tmp_path / "pty.mcap",
            port=port,
            upload=False,
            camera_delay_us=4000,
        )
        result = fly_port(order, port, mocap_url)
        assert end()["simulated_s"] > 10.0
    assert result.end is not None
    assert result.end.whole
    assert result.tracking_rmse_m is not None
    assert result.tracking_rmse_m < 0.15
    flight = read_flight(result.log)
    assert flight.tracking_whole
    uid = flight.metadata["session_uid"]
    assert uid == json.loads(truth.read_text())["uid"]
    assert uid != f"{session_uid(2, 0):016x}"  # that of a flight in lock-step
    assert is_simulated(flight.metadata)


def test_pty_stand_in_flies_by_setpoints_and_says_that_it_is_simulated(
    run_trimtab: Callable[..., tuple[int, dict, str]], reference: Reference, mocap_url: str, tmp_path: Path
) -> None:
    (tmp_path / "eight.ref").write_bytes(reference.to_bytes())
    with served("--port", "pty", "--mocap", mocap_url, "--autopilot", "px4") as (port, end):
        line = ("--autopilot", "px4", "--port", port, "--mocap", mocap_url, "-o", "x.mcap", "--json")
        code, _, complaint = run_trimtab("fly", "eight.ref", *line)
        assert code == 2
        assert "nobody is asked before the vehicle is armed" in complaint
        code, _, complaint = run_trimtab("fly", "eight.ref", *line[2:])
        assert code == 3
        assert "does not speak Trimtab's dialect" in complaint
        code, told, complaint = run_trimtab("fly", "eight.ref", *line, "--yes")
        assert code == 0, complaint
        lines = [each.removeprefix("trimtab: ") for each in complaint.splitlines()]
        assert [each for each in lines if not each.startswith("poses arrive")] == [
            "checking", "arming", "to the start", "tracking", "hold", "landing", "landed"
        ]  # fmt: skip
        end()
    assert told["whole"]
    assert told["tracking_rmse_m"] < 0.15
    assert told["link"]["frames_lost"] is None
    assert is_simulated(read_flight(tmp_path / "x.mcap").metadata)
    assert "epoch_us" not in read_flight(tmp_path / "x.mcap").metadata


def test_pty_key_is_installed_by_cable_and_then_needed_over_the_radio(
    run_trimtab: Callable[..., tuple[int, dict, str]], reference: Reference, mocap_url: str, tmp_path: Path
) -> None:
    (tmp_path / "eight.ref").write_bytes(reference.to_bytes())
    assert run_trimtab("key", "new", "lab.key")[0] == 0
    memory = ("--memory", str(tmp_path / "vehicle.memory"))
    with served("--port", "pty", "--world", "wired", *memory) as (port, end):
        assert run_trimtab("key", "install", "lab.key", "--port", port)[0] == 0
        end()
    with served("--port", "pty", "--mocap", mocap_url, *memory) as (port, end):
        code, _, complaint = run_trimtab("upload", "eight.ref", "--port", port)
        assert (code, len(complaint.splitlines())) == (3, 1)
        assert "give its key with --key FILE" in complaint
        code, _, complaint = run_trimtab("key", "revoke", "--port", port)
        assert code == 3
        assert "connect the vehicle by cable" in complaint
        key = ("--port", port, "--key", "lab.key")
        code, _, complaint = run_trimtab("upload", "eight.ref", "--read-back", *key)
        assert code == 0, complaint
        words = ("--mocap", mocap_url, "-o", "x.mcap", "--json")
        code, told, complaint = run_trimtab("fly", "eight.ref", *key, *words)
        assert code == 0, complaint
        end()
    assert told["whole"]
    assert told["tracking_rmse_m"] < 0.15


@pytest.mark.full  # beside the flight above
def test_pty_signed_flight_by_cable_and_a_flight_after_the_key_was_revoked(
    run_trimtab: Callable[..., tuple[int, dict, str]], reference: Reference, mocap_url: str, tmp_path: Path
) -> None:
    (tmp_path / "eight.ref").write_bytes(reference.to_bytes())
    run_trimtab("key", "new", "lab.key")
    with served("--port", "pty", "--mocap", mocap_url, "--world", "wired") as (port, end):
        code, told, complaint = run_trimtab("key", "install", "lab.key", "--port", port, "--json")
        assert (code, told) == (0, {"file": "lab.key", "port": port}), complaint
        for key in (("--key", "lab.key"), ()):
            words = ("--port", port, *key)
            assert run_trimtab("upload", "eight.ref", *words)[0] == 0
            words = (*words, "--mocap", mocap_url, "-o", "x.mcap", "--force", "--json")
            code, told, complaint = run_trimtab("fly", "eight.ref", *words)
            assert code == 0, complaint
            assert told["whole"]
            code, told, complaint = run_trimtab("key", "revoke", "--port", port, "--json")
            assert (code, told) == (0, {"port": port}), complaint
        end()


@pytest.mark.full  # beside the flight above and those over lossy links in lock-step
def test_pty_flight_over_a_radio_that_loses_a_fifth_of_its_frames(
    vehicle: Vehicle, reference: Reference, mocap_url: str, tmp_path: Path
) -> None:
    with served("--port", "pty", "--mocap", mocap_url, "--world", "lossy-link") as (port, end):
        upload_port(reference, port)
        order = FlightRequest(
            vehicle=vehicle,
            reference=reference,
            log_path=tmp_path / "lossy.mcap",
            port=port,
            upload=False,
            camera_delay_us=4000,
        )
        result = fly_port(order, port, mocap_url)
        end()
    assert result.end is not None
    assert result.end.whole
    assert result.link["frames_lost"] > 0.08 * result.link["frames_sent"]
    assert result.tracking_rmse_m is not None
    assert result.tracking_rmse_m < 0.15


@pytest.mark.full  # beside the flights of test_host_control.py in lock-step
def test_pty_flight_by_a_controller_on_the_host(
    vehicle: Vehicle, reference: Reference, mocap_url: str, tmp_path: Path
) -> None:
    with served("--port", "pty", "--mocap", mocap_url) as (port, end):
        upload_port(reference, port)
        order = FlightRequest(
            vehicle=vehicle,
            reference=reference,
            log_path=tmp_path / "steered.mcap",
            port=port,
            upload=False,
            camera_delay_us=4000,
            control=HostControl(controller=RateController(vehicle), name="outer-loop", settings_id="0" * 12),
        )
        result = fly_port(order, port, mocap_url)
        end()
    assert result.end is not None
    assert result.end.whole
    assert result.tracking_rmse_m is not None
    assert result.tracking_rmse_m < 0.15
    steps = read_flight(result.log).host_control
    assert steps is not None
    assert len(steps) > 0.9 * (reference.duration_us + 2_000_000) / steps.period_us


@pytest.mark.full  # beside the flights in lock-step and the upload in test_correct.py
def test_pty_flight_after_upload_of_a_correction_flies_with_it(
    run_trimtab: Callable[..., tuple[int, dict, str]],
    vehicle: Vehicle,
    reference: Reference,
    drag_model: str,
    mocap_url: str,
    tmp_path: Path,
) -> None:
    (tmp_path / "eight.ref").write_bytes(reference.to_bytes())
    assert run_trimtab("correct", drag_model, "-o", "drag.ff")[0] == 0
    with served("--port", "pty", "--mocap", mocap_url, "--world", "paper-drag") as (port, end):
        for blob in ("eight.ref", "drag.ff"):
            assert run_trimtab("upload", blob, "--port", port)[0] == 0
        words = ("--port", port, "--mocap", mocap_url, "--feedforward", "drag.ff", "-o", "x.mcap", "--json")
        code, told, complaint = run_trimtab("fly", "eight.ref", *words)
        end()
    assert code == 0, complaint
    assert told["whole"]
    assert told["tracking_rmse_m"] < 0.15
    flight = read_flight(tmp_path / "x.mcap")
    assert flight.feedforward is not None
    assert flight.feedforward.to_bytes() == (tmp_path / "drag.ff").read_bytes()
    assert flight.metadata["feedforward_id"] == flight.feedforward.id
