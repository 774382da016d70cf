"""pymavlink's mavftp carries a reference to the vehicle and back; committed by MAV_CMD_USER_1, it flies."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

pytestmark = [pytest.mark.full, pytest.mark.realtime]

ACCEPTED, FAILED = 0, 4
USER_1 = 31010


class Files:
    """mavftp on a ground station. An operation that lost a message is done again, as a person would."""

    def __init__(self, station: Any) -> None:
        from pymavlink import mavftp

        self._error = mavftp.FtpError
        self._ftp = mavftp.MAVFTP(station.link, 1, 1)

    def put(self, file: Path, path: str) -> None:
        """Write a file. mavftp never repeats a lost CreateFile: it writes, and no session is open."""
        while True:
            self._ftp.cmd_put([str(file), path])
            answer = self._ftp.process_ftp_reply("put", timeout=30)
            if answer.error_code != self._error.InvalidSession and self._done(answer):
                return

    def get(self, path: str, file: Path) -> bytes:
        while True:
            self._ftp.cmd_get([path, str(file)])
            if self._done(self._ftp.process_ftp_reply("OpenFileRO", timeout=30)) and file.exists():
                return file.read_bytes()

    def list(self, path: str) -> dict[str, int | None]:
        """Size by name, None for a folder."""
        while not self._done(self._ftp.cmd_list([path])):
            pass
        return {entry.name: None if entry.is_dir else entry.size_b for entry in self._ftp.list_result}

    def remove(self, path: str) -> None:
        while not self._done(self._ftp.cmd_rm([path])):
            pass

    def refused(self, path: str, file: Path) -> bool:
        """Whether there is nothing to be got at the path."""
        self._ftp.cmd_get([path, str(file)])
        return self._ftp.process_ftp_reply("OpenFileRO", timeout=30).error_code == self._error.FileNotFound

    def _done(self, answer: Any) -> bool:
        if answer.error_code == self._error.Success:
            return True
        assert answer.error_code in (self._error.RemoteReplyTimeout, self._error.Fail), answer.error_code
        return False


def test_mavftp_uploads_commits_flies_and_reads_back(
    serve: Callable[..., str],
    station: Callable[..., Any],
    reference_file: Path,
    commit_words: Callable[[Path], tuple[int, int, int]],
    flown: Callable[[Any], bool],
    tmp_path: Path,
) -> None:
    data = reference_file.read_bytes()
    own = station("udpout:" + serve())
    own.answer("HEARTBEAT")
    files = Files(own)
    assert files.list("/") == {"ref": None, "ff": None}
    assert files.list("/ref") == {}
    assert files.refused("/ref/live.ref", tmp_path / "none.ref")
    assert own.command(USER_1, *commit_words(reference_file)) == FAILED  # nothing is staged

    files.put(reference_file, "/ref/staged.ref")
    assert files.list("/ref") == {"staged.ref": len(data)}
    assert files.get("/ref/staged.ref", tmp_path / "staged.ref") == data
    assert own.command(USER_1, 1, 2, 3) == FAILED  # not that one
    assert own.command(USER_1, *commit_words(reference_file)) == ACCEPTED
    assert files.list("/ref") == {"live.ref": len(data)}
    assert files.get("/ref/live.ref", tmp_path / "live.ref") == data

    own.fly()
    assert flown(own.track)
    assert files.get("/ref/live.ref", tmp_path / "after.ref") == data


def test_mavftp_cannot_stage_what_the_vehicle_must_not_fly(
    serve: Callable[..., str], station: Callable[..., Any], reference_file: Path, tmp_path: Path
) -> None:
    """A damaged file is refused as a whole, with the reason; one that was staged can be taken back."""
    own = station("udpout:" + serve())
    own.answer("HEARTBEAT")
    files = Files(own)
    damaged = tmp_path / "damaged.ref"
    damaged.write_bytes(reference_file.read_bytes()[:-40])
    while not any("staged.ref refused" in text for text in own.texts):  # a text may be lost
        files.put(damaged, "/ref/staged.ref")
        own.step(wait_s=1.0)
    assert files.list("/ref") == {}
    files.put(reference_file, "/ref/staged.ref")
    assert "staged.ref" in files.list("/ref")
    files.remove("/ref/staged.ref")
    assert files.list("/ref") == {}
