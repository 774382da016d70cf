"""Logs that cannot be written to their end."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager, closing
from pathlib import Path

import pytest

from trimtab.host.base.artefacts import reserve_log
from trimtab.host.base.parts import part_path
from trimtab.host.log import LogError, LogWriter, Provenance, read_flight, recover
from trimtab.host.log.writer import Stamps, publish_log

FullDisk = Callable[[int], AbstractContextManager[None]]


def _write_poses(log: LogWriter, count: int) -> None:
    """Poses that compress badly."""
    for k in range(count):
        noise = [((k * 7919 + i * 104729) % 1000003) / 7.0 for i in range(3)]
        log.pose(Stamps(1000 * k, 1000 * k, 1000 * k), 0, noise, (1.0, 0.0, 0.0, 0.0))


def test_writer_on_a_full_disk_raises_and_leaves_what_it_had_written(
    tmp_path: Path, provenance: Provenance, full_disk: FullDisk
) -> None:
    path = tmp_path / "full.mcap"
    log = LogWriter(path, provenance)
    with full_disk(100_000), pytest.raises(LogError, match=r"full\.mcap: cannot be written .*log recover"):
        _write_poses(log, 10_000)
    # There is room again, but half a chunk lies at the end.
    with pytest.raises(LogError, match="cannot be written"):
        _write_poses(log, 10_000)
    log.close()
    assert [entry.name for entry in tmp_path.iterdir()] == ["full.mcap.part"]
    found = recover(path)
    assert found.output is not None
    mocap = read_flight(found.output).mocap
    assert mocap is not None
    assert len(mocap) > 500


def test_writer_whose_end_does_not_fit_keeps_its_chunks(
    tmp_path: Path, provenance: Provenance, full_disk: FullDisk
) -> None:
    path = tmp_path / "full.mcap"
    log = LogWriter(path, provenance)
    _write_poses(log, 2_000)
    with (
        full_disk(part_path(path).stat().st_size + 10),
        pytest.raises(LogError, match="cannot be written"),
    ):
        log.close()
    assert [entry.name for entry in tmp_path.iterdir()] == ["full.mcap.part"]
    assert recover(path).output is not None


def test_writer_that_cannot_write_its_first_bytes_leaves_nothing(
    tmp_path: Path, provenance: Provenance, full_disk: FullDisk
) -> None:
    with full_disk(100), pytest.raises(LogError, match=r"cannot be written \(.*\); free disk space and try"):
        LogWriter(tmp_path / "full.mcap", provenance)
    assert not list(tmp_path.iterdir())


def test_writer_without_a_whole_chunk_advises_no_recovery_and_leaves_nothing(
    tmp_path: Path, provenance: Provenance, full_disk: FullDisk
) -> None:
    path = tmp_path / "full.mcap"
    log = LogWriter(path, provenance)
    with (
        full_disk(part_path(path).stat().st_size + 10_000),
        pytest.raises(LogError, match=r"free disk space and try again"),
    ):
        _write_poses(log, 10_000)
    log.close()
    assert not list(tmp_path.iterdir())


def test_writer_whose_block_ends_on_a_full_disk_advises_no_recovery_and_leaves_nothing(
    tmp_path: Path, provenance: Provenance, full_disk: FullDisk
) -> None:
    with (
        full_disk(300_000),
        pytest.raises(LogError, match=r"free disk space and try again"),
        LogWriter(tmp_path / "full.mcap", provenance) as log,
    ):
        _write_poses(log, 20_000)
    assert not list(tmp_path.iterdir())


def test_whole_log_whose_name_is_taken_stays_and_is_named(tmp_path: Path, provenance: Provenance) -> None:
    path = tmp_path / "a.mcap"
    with closing(reserve_log(path)) as part:
        log = LogWriter(part, provenance)
        _write_poses(log, 2_000)
        log.close()
        path.write_bytes(b"theirs")
        with pytest.raises(LogError, match=r"a\.mcap: .*another file has it now.*whole in .*a\.mcap\.part"):
            publish_log(part)
    assert path.read_bytes() == b"theirs"
    assert read_flight(part_path(path)).mocap is not None


def _begin(path: Path, provenance: Provenance, error: BaseException) -> None:
    """Starts to write a log, then raises `error`."""
    with LogWriter(path, provenance) as log:
        _write_poses(log, 3_000)
        raise error


@pytest.mark.parametrize("error", [ValueError, KeyboardInterrupt])
def test_writer_whose_block_raises_leaves_nothing(
    tmp_path: Path, provenance: Provenance, error: type[BaseException]
) -> None:
    with pytest.raises(error):
        _begin(tmp_path / "x.mcap", provenance, error())
    assert not list(tmp_path.iterdir())
