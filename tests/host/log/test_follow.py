"""Reading a log while it is written."""

from __future__ import annotations

from contextlib import closing
from pathlib import Path

import pytest

from trimtab.host.base.artefacts import reserve_log
from trimtab.host.base.parts import part_path
from trimtab.host.log import LogError
from trimtab.host.log.follow import LogFollower
from trimtab.host.log.scan import Entry, scan


@pytest.mark.parametrize("step", [1000, 40_000, 10_000_000])
def test_follower_returns_every_message_once_as_the_file_grows(
    tmp_path: Path, log_bytes: bytes, log_path: Path, step: int
) -> None:
    target = tmp_path / "growing.mcap"
    messages: list[Entry] = []
    with LogFollower(target) as follower, part_path(target).open("wb", buffering=0) as file:
        assert follower.poll() == []
        for start in range(0, len(log_bytes), step):
            assert not follower.ended
            file.write(log_bytes[start : start + step])
            messages += follower.poll()
        assert follower.ended
        part_path(target).replace(target)
        assert follower.poll() == []
    whole = scan(log_path)
    assert messages == whole.messages
    assert follower.content.channels == whole.channels
    assert follower.content.metadata == whole.metadata


def test_follower_waits_for_a_log_and_prefers_the_one_being_written(
    tmp_path: Path, log_bytes: bytes, log_path: Path
) -> None:
    with LogFollower(tmp_path / "none.mcap") as follower:
        assert (follower.poll(), follower.ended) == ([], False)
    part_path(log_path).write_bytes(log_bytes[: len(log_bytes) // 2])
    with LogFollower(log_path) as follower:
        assert 0 < len(follower.poll()) < len(scan(log_path).messages)
        assert not follower.ended


@pytest.mark.parametrize("place", [3, -1])
def test_follower_of_a_damaged_or_foreign_file_says_so(tmp_path: Path, log_bytes: bytes, place: int) -> None:
    path = tmp_path / "x.mcap"
    damaged = bytearray(log_bytes)
    damaged[place if place > 0 else log_bytes.index(b"zstd") + 40] ^= 0x55
    path.write_bytes(damaged)
    with LogFollower(path) as follower, pytest.raises(LogError, match=r"x\.mcap"):
        follower.poll()


def test_follower_takes_the_part_that_is_written_not_what_an_interrupted_flight_left(
    tmp_path: Path, log_bytes: bytes
) -> None:
    target = tmp_path / "a.mcap"
    part_path(target).write_bytes(log_bytes[: len(log_bytes) // 2])
    with closing(reserve_log(target, force=True)) as part, LogFollower(target) as follower:
        part.file.write(log_bytes)
        follower.poll()
        assert follower.ended


def test_follower_waits_while_a_reserved_log_is_empty(tmp_path: Path, log_bytes: bytes) -> None:
    target = tmp_path / "a.mcap"
    with LogFollower(target) as follower:
        with closing(reserve_log(target)):
            assert follower.poll() == []
        with closing(reserve_log(target)) as part:  # the next start, after one that came to nothing
            part.file.write(log_bytes)
            follower.poll()
        assert follower.ended
