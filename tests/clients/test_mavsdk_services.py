"""MAVSDK's examples unchanged, and its functions that the vehicle refuses: each ends with the true reason."""

# pyright: reportMissingImports=false
# MAVSDK is of the extra `clients`.

from __future__ import annotations

import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

pytestmark = [pytest.mark.full, pytest.mark.realtime]


@pytest.fixture(autouse=True)
def _clients(require: Callable[[str], None]) -> None:
    require("clients")


def test_takeoff_and_land_example_runs(serve: Callable[..., str], connect: Callable[[str], Any]) -> None:
    """The steps of takeoff_and_land.py; the vehicle is in the air where the example sleeps."""
    from mavsdk.plugins.telemetry import LandedState

    vehicle = connect(f"udpout://{serve()}")
    vehicle.until(
        lambda: (
            vehicle.health is not None
            and vehicle.health.is_global_position_ok
            and vehicle.health.is_home_position_ok
        )
    )
    vehicle.action.arm()
    vehicle.action.takeoff()
    vehicle.until(lambda: vehicle.landed_state == LandedState.IN_AIR)
    vehicle.land()


def test_parameters_that_are_refused_have_true_results(
    on_the_floor: str, connect: Callable[[str], Any]
) -> None:
    from mavsdk.plugins.param import ParamError, ParamResult

    param = connect(f"udpout://{on_the_floor}").param

    def result(act: Callable[..., Any], *words: Any) -> ParamResult:
        with pytest.raises(ParamError) as caught:
            act(*words)
        return ParamResult[str(caught.value).partition(";")[0]]

    assert result(param.set_param_float, "HOLD_S", -3.0) == ParamResult.VALUE_OUT_OF_RANGE
    assert result(param.set_param_int, "BAT_CELLS", 99) == ParamResult.VALUE_OUT_OF_RANGE
    assert result(param.set_param_float, "NOPE", 1.0) == ParamResult.DOES_NOT_EXIST
    assert result(param.get_param_float, "NOPE") == ParamResult.DOES_NOT_EXIST
    assert result(param.get_param_int, "NOPE_INT") == ParamResult.DOES_NOT_EXIST
    assert param.get_param_float("HOLD_S") == 1.0


def test_missions_fences_and_rally_points_are_unsupported(
    on_the_floor: str, connect: Callable[[str], Any]
) -> None:
    from mavsdk.plugins.mission_raw import MissionItem, MissionRaw, MissionRawError

    raw = MissionRaw(connect(f"udpout://{on_the_floor}").system)

    def item(kind: int, command: int) -> MissionItem:
        place: dict[str, Any] = {"x": 473977420, "y": 85455940, "z": 5.0, "mission_type": kind}
        params = {f"param{k}": 0.0 for k in range(1, 5)}
        return MissionItem(seq=0, frame=6, command=command, current=1, autocontinue=1, **params, **place)

    for upload, wanted in (
        (raw.upload_mission, item(0, 16)),
        (raw.upload_geofence, item(1, 5001)),
        (raw.upload_rally_points, item(2, 5100)),
    ):
        with pytest.raises(MissionRawError, match=r"^UNSUPPORTED"):
            upload([wanted])
    assert raw.download_mission() == raw.download_geofence() == raw.download_rallypoints() == []


def test_logs_and_shell_end_with_what_there_is(on_the_floor: str, connect: Callable[[str], Any]) -> None:
    from mavsdk.plugins.log_files import LogFiles, LogFilesError
    from mavsdk.plugins.shell import Device, Shell

    system = connect(f"udpout://{on_the_floor}").system
    with pytest.raises(LogFilesError, match=r"^NO_LOGFILES"):
        LogFiles(system).get_entries()
    shell, heard, lines = Shell(system), threading.Event(), []

    def receive(answer: Any, _: Any) -> None:
        lines.append(answer.data)
        heard.set()

    shell.subscribe_receive(receive)
    while not heard.wait(1.0):  # the radio loses frames
        shell.send("help\n", Device.SHELL)
    assert lines[0].startswith("no shell on this vehicle")


def test_upload_of_a_file_that_is_too_large_ends_at_once(
    on_the_floor: str, connect: Callable[[str], Any], reference_file: Path, tmp_path: Path
) -> None:
    """Its first packet is refused: the vehicle never holds the rest."""
    from mavsdk.plugins.ftp import Ftp, FtpResult

    vehicle = connect(f"udpout://{on_the_floor}")
    data = bytearray(reference_file.read_bytes())
    data[38:42] = (6000).to_bytes(4, "little")  # the count of nodes
    file = tmp_path / "staged.ref"
    file.write_bytes(bytes(data).ljust(312_058, b"\0"))
    done, results, sent = threading.Event(), [], []

    def progress(result: FtpResult, now: Any, _: Any) -> None:
        if result == FtpResult.NEXT:
            sent.append(now.bytes_transferred)
        else:
            results.append(result)
            done.set()

    Ftp(vehicle.system).upload_async(str(file), "/ref", progress)
    done.wait()
    assert results == [FtpResult.PROTOCOL_ERROR]
    assert max(sent, default=0) < 1_000
    vehicle.until(lambda: any("at most 262144" in text for text in vehicle.texts))
