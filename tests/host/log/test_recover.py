"""A log cut or damaged anywhere is either read, recovered or refused in one line."""

from __future__ import annotations

import re
import signal
import subprocess
import sys
from collections.abc import Callable
from contextlib import AbstractContextManager, closing
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from trimtab.host.base.artefacts import reserve_log
from trimtab.host.base.errors import UsageError
from trimtab.host.base.parts import part_path
from trimtab.host.log import LogError, LogWriter, Provenance, read_flight, recover
from trimtab.host.log.writer import Stamps

KILLED_WRITER = """
import os, signal, sys
from pathlib import Path
from trimtab.host.log import LogWriter, Provenance
from trimtab.host.log.writer import Stamps
from trimtab.host.vehicle import load_vehicle
log = LogWriter(Path(sys.argv[1]), Provenance(vehicle=load_vehicle("research")))
for ms in range(0, 30000, 10):
    noise = [((ms * 7919 + k * 104729) % 1000003) / 7.0 for k in range(3)]
    log.pose(Stamps(ms * 1000, ms * 1000, ms * 1000), 0, noise, (1.0, 0.0, 0.0, 0.0))
    log.estimate(Stamps(ms * 1000, ms * 1000, ms * 1000), noise, noise, (1.0, 0.0, 0.0, 0.0), noise, noise, 1)
os.kill(os.getpid(), signal.SIGKILL)
"""


def _one_line(error: LogError) -> None:
    assert error.exit_code == 5
    assert "\n" not in str(error)
    assert len(str(error)) > 20


def _read_or_recover(path: Path) -> str:
    """What became of a damaged log: "read", "recovered", "recovered unreadable" or "refused"."""
    try:
        read_flight(path)
        return "read"
    except LogError as error:
        _one_line(error)
    try:
        found = recover(path)
    except LogError as error:
        _one_line(error)
        return "refused"
    if found.output is None:
        return "read"
    flight = read_flight(found.output)
    assert flight.mocap is not None
    found.output.unlink()
    return "recovered"


def test_log_cut_anywhere_is_recovered_from_its_first_chunk_on(tmp_path: Path, log_bytes: bytes) -> None:
    path = tmp_path / "cut.mcap"
    points = {0, 1, 7, 8, 9, len(log_bytes) - 1, len(log_bytes) - 8, len(log_bytes) - 9}
    points |= set(np.random.default_rng(1).integers(0, len(log_bytes), 50).tolist())
    outcomes = []
    for point in sorted(points):
        path.write_bytes(log_bytes[:point])
        outcomes.append(_read_or_recover(path))
    # First nothing is left, then ever more is; a cut file is never taken for a whole one.
    assert set(outcomes) == {"refused", "recovered"}
    assert outcomes == sorted(outcomes, reverse=True)
    first = log_bytes.index(b"zstd")
    lost = sum(point < first for point in points)
    assert outcomes[:lost] == ["refused"] * lost


def test_recover_cut_log_keeps_provenance_and_every_whole_chunk(
    tmp_path: Path, log_bytes: bytes, log_path: Path
) -> None:
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(log_bytes[: len(log_bytes) // 2])
    found = recover(cut)
    recovered = tmp_path / "cut.recovered.mcap"
    assert found.output == recovered
    whole, part = read_flight(log_path), read_flight(recovered)
    assert part.vehicle == whole.vehicle
    assert part.reference == whole.reference
    assert part.firmware_parameters == whole.firmware_parameters
    assert part.mocap is not None
    assert whole.mocap is not None
    assert 100 < len(part.mocap) < len(whole.mocap)
    np.testing.assert_array_equal(part.mocap.p, whole.mocap.p[: len(part.mocap)])


def test_recover_whole_log_writes_nothing(tmp_path: Path, log_path: Path) -> None:
    found = recover(log_path)
    assert found.output is None
    assert list(tmp_path.iterdir()) == [log_path]


def test_recover_killed_writer_leaves_what_it_had_written(tmp_path: Path) -> None:
    path = tmp_path / "killed.mcap"
    done = subprocess.run([sys.executable, "-c", KILLED_WRITER, str(path)], check=False)
    assert done.returncode == -signal.SIGKILL
    assert not path.exists()
    assert part_path(path).exists()
    with pytest.raises(LogError, match=r"trimtab log recover .*killed\.mcap\.part"):
        read_flight(path)
    found = recover(path)
    assert found.output is not None
    assert found.output.name == "killed.recovered.mcap"
    mocap = read_flight(found.output).mocap
    assert mocap is not None
    # 64 KiB chunks hold about 190 pairs of messages: no more than one chunk is lost.
    assert 2700 <= len(mocap) < 3000


def test_log_that_is_still_written_is_not_recovered(
    tmp_path: Path, provenance: Provenance, log_bytes: bytes
) -> None:
    path = tmp_path / "a.mcap"
    with closing(reserve_log(path)) as part:
        part.file.write(log_bytes[: len(log_bytes) // 2])
        for act in (read_flight, recover):
            with pytest.raises(
                LogError, match=r"a\.mcap\.part: is being written; .*`trimtab watch .*a\.mcap`"
            ):
                act(path)
    assert recover(path).output == tmp_path / "a.recovered.mcap"


def test_recover_of_two_interrupted_logs_names_both(tmp_path: Path, log_bytes: bytes) -> None:
    path = tmp_path / "a.mcap"
    for number in (1, 2):
        part_path(path, number).write_bytes(log_bytes[: len(log_bytes) // (number + 1)])
    with pytest.raises(LogError, match=r"2 unfinished logs; give one of .*a\.mcap\.2\.part, .*a\.mcap\.part"):
        recover(path)
    with pytest.raises(LogError, match=r"is a folder; give a log; .*a\.mcap\.2\.part .*was interrupted"):
        recover(tmp_path)
    outputs = [recover(part_path(path, number)).output for number in (1, 2)]
    assert outputs == [tmp_path / "a.recovered.mcap", tmp_path / "a.2.recovered.mcap"]


def test_recover_into_a_folder_that_is_not_there_is_refused(tmp_path: Path, log_bytes: bytes) -> None:
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(log_bytes[:-40])
    with pytest.raises(UsageError, match="its folder does not exist"):
        recover(cut, tmp_path / "no" / "x.mcap")
    assert [path.name for path in tmp_path.iterdir()] == ["cut.mcap"]


def test_recover_onto_the_name_of_the_log_keeps_what_it_reads(tmp_path: Path, log_bytes: bytes) -> None:
    path = tmp_path / "cut.mcap"
    cut = log_bytes[: len(log_bytes) // 2]
    part_path(path).write_bytes(cut)
    found = recover(path, path)
    assert found.output == path
    assert read_flight(path).mocap is not None
    assert part_path(path).read_bytes() == cut
    assert sorted(entry.name for entry in tmp_path.iterdir()) == ["cut.mcap", "cut.mcap.part"]


def test_recover_that_cannot_write_leaves_nothing(
    tmp_path: Path, log_bytes: bytes, full_disk: Callable[[int], AbstractContextManager[None]]
) -> None:
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(log_bytes[:-40])
    with full_disk(1000), pytest.raises(LogError, match="cannot be written"):
        recover(cut)
    assert [entry.name for entry in tmp_path.iterdir()] == ["cut.mcap"]


@pytest.mark.parametrize("damaged", [0, 1])
def test_recover_leaves_out_a_damaged_chunk_and_keeps_the_others(
    tmp_path: Path, provenance: Provenance, damaged: int
) -> None:
    path = tmp_path / "x.mcap"
    with LogWriter(path, provenance) as log:
        for k in range(4000):
            noise = [((k * 7919 + i * 104729) % 1000003) / 7.0 for i in range(3)]
            log.pose(Stamps(1000 * k, 1000 * k, 1000 * k), 0, noise, (1.0, 0.0, 0.0, 0.0))
    content = bytearray(path.read_bytes())
    places = [place.start() for place in re.finditer(b"zstd", content)]
    content[places[damaged] + 1000] ^= 0xFF
    path.write_bytes(content)
    with pytest.raises(LogError, match=r"1 damaged.*trimtab log recover"):
        read_flight(path)
    found = recover(path)
    assert found.output is not None
    assert "1 damaged" in found.damage
    mocap = read_flight(found.output).mocap
    assert mocap is not None
    gaps_us = np.diff(mocap.t_arrival_us, prepend=-1000)
    lost = int(gaps_us.max()) // 1000 - 1
    assert 100 < lost < 1000
    assert len(mocap) == 4000 - lost


@given(data=st.data())
def test_log_with_flipped_bytes_never_surprises(
    tmp_path_factory: pytest.TempPathFactory, log_bytes: bytes, data: st.DataObject
) -> None:
    damaged = bytearray(log_bytes)
    for _ in range(data.draw(st.integers(1, 3))):
        damaged[data.draw(st.integers(8, len(damaged) - 1))] = data.draw(st.integers(0, 255))
    path = tmp_path_factory.mktemp("flip") / "x.mcap"
    path.write_bytes(damaged)
    assert _read_or_recover(path) in ("read", "recovered", "refused")


@given(tail=st.binary(max_size=400))
def test_log_of_random_bytes_is_refused(tmp_path_factory: pytest.TempPathFactory, tail: bytes) -> None:
    path = tmp_path_factory.mktemp("noise") / "x.mcap"
    path.write_bytes(b"\x89MCAP0\r\n" + tail)
    assert _read_or_recover(path) == "refused"
