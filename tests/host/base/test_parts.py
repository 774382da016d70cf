"""Files that are being written: names of their own, held by a lock, published over nobody's file."""

from __future__ import annotations

import errno
import multiprocessing
import os
import signal
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import closing, suppress
from multiprocessing.synchronize import Barrier
from pathlib import Path

import pytest

from trimtab.host.base import parts
from trimtab.host.base.artefacts import open_atomic, own_folder, reserve_log, write_atomic, write_recorded
from trimtab.host.base.errors import UsageError
from trimtab.host.base.parts import (
    NameTaken,
    PartState,
    look,
    open_only_part,
    open_part,
    part_path,
    target_of,
    unfinished,
    unfinished_in,
)
from trimtab.host.log import LogError, read_flight

NOBODY = 65534
KILLED = """
import os, signal, sys
from pathlib import Path
from trimtab.host.base.parts import open_only_part
part = open_only_part(Path(sys.argv[1]))
part.file.write(sys.argv[2].encode())
os.kill(os.getpid(), signal.SIGKILL)
"""


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def killed_writer(target: Path, content: str = "half") -> Path:
    """The part that a process leaves which is killed while it writes."""
    done = subprocess.run([sys.executable, "-c", KILLED, str(target), content], check=False)
    assert done.returncode == -signal.SIGKILL
    return part_path(target)


@pytest.mark.parametrize("number", [1, 2, 10, 100])
def test_part_path_of_a_log_leads_back_to_it(number: int) -> None:
    log = Path("folder/eight-1.mcap")
    part = part_path(log, number)
    assert part.name == "eight-1.mcap.part" if number == 1 else f"eight-1.mcap.{number}.part"
    assert target_of(part) == log
    assert target_of(log) == log


def test_parts_of_one_file_have_names_of_their_own(tmp_path: Path) -> None:
    target = tmp_path / "a.html"
    with closing(open_part(target)) as first, closing(open_part(target)) as second:
        assert names(tmp_path) == ["a.html.2.part", "a.html.part"]
        first.file.write(b"first")
        second.file.write(b"second")
        second.publish()
        with pytest.raises(NameTaken, match="exists; choose another name or add --force"):
            first.publish()
        assert target.read_bytes() == b"second"
        assert first.path.read_bytes() == b"first"


def test_part_is_told_apart_by_what_became_of_its_writer(tmp_path: Path) -> None:
    target = tmp_path / "a.mcap"
    killed = killed_writer(target)
    with closing(open_part(target)) as part:
        assert [(each.path, each.state, each.size) for each in unfinished(target)] == [
            (part.path, PartState.WRITING, 0),
            (killed, PartState.INTERRUPTED, 4),
        ]
    assert [each.path for each in unfinished_in(tmp_path)] == [killed]
    assert look(tmp_path / "a.mcap") is None


def test_reserved_name_is_refused_to_others_forced_or_not(tmp_path: Path) -> None:
    target = tmp_path / "a.mcap"
    with closing(open_only_part(target)) as part:
        for force in (False, True):
            with pytest.raises(NameTaken, match=r"a\.mcap: another process is writing it"):
                reserve_log(target, force)
        assert names(tmp_path) == ["a.mcap.part"]
        part.file.write(b"flight")
        part.publish()
    with pytest.raises(NameTaken, match="exists"):
        reserve_log(target)
    with closing(reserve_log(target, force=True)):
        assert target.read_bytes() == b"flight"


def test_reservation_that_comes_to_nothing_leaves_nothing(tmp_path: Path) -> None:
    reserve_log(tmp_path / "a.mcap").close()
    assert names(tmp_path) == []
    killed_writer(tmp_path / "a.mcap", "")
    reserve_log(tmp_path / "a.mcap").close()
    assert names(tmp_path) == []


def test_interrupted_log_stays_until_a_forced_one_is_whole(tmp_path: Path) -> None:
    target = tmp_path / "a.mcap"
    killed = killed_writer(target)
    with pytest.raises(NameTaken, match=r"a\.mcap\.part: the log of an interrupted flight; run `trimtab log"):
        reserve_log(target)
    with closing(reserve_log(target, force=True)) as part:
        part.file.write(b"whole")
        assert killed.read_bytes() == b"half"
        part.publish()
    assert names(tmp_path) == ["a.mcap"]


def test_interrupted_page_makes_room_for_the_next(tmp_path: Path) -> None:
    killed_writer(tmp_path / "a.html")
    write_atomic(tmp_path / "a.html", "whole")
    assert names(tmp_path) == ["a.html"]


def test_part_removed_before_it_is_locked_is_opened_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Another process may take it for one of an interrupted writer."""
    lock, removed = parts.fcntl.flock, []

    def late(handle: int, operation: int) -> None:
        if not removed:
            removed.append((tmp_path / "a.html.part").unlink())
        lock(handle, operation)

    monkeypatch.setattr(parts.fcntl, "flock", late)
    write_atomic(tmp_path / "a.html", "whole")
    assert (tmp_path / "a.html").read_text() == "whole"


def test_file_system_without_hard_links_overwrites_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def none(*_: object) -> None:
        raise OSError(errno.EPERM, "no hard links")

    monkeypatch.setattr(os, "link", none)
    target = tmp_path / "a.html"
    with closing(open_part(target)) as part:
        part.file.write(b"ours")
        target.write_bytes(b"theirs")
        with pytest.raises(NameTaken):
            part.publish()
        assert target.read_bytes() == b"theirs"
        target.unlink()
        part.publish()
    assert target.read_bytes() == b"ours"
    assert names(tmp_path) == ["a.html"]


def test_file_system_without_locks_removes_and_overwrites_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def none(*_: object) -> None:
        raise OSError(errno.ENOLCK, "no locks")

    monkeypatch.setattr(parts.fcntl, "flock", none)
    target = tmp_path / "a.mcap"
    with closing(open_only_part(target)) as part:
        part.file.write(b"half")
        for force in (False, True):
            with pytest.raises(NameTaken, match="another process may be writing it"):
                reserve_log(target, force)
        part.publish()
    assert target.read_bytes() == b"half"


@pytest.fixture
def open_folder() -> Iterator[Path]:
    """A folder of root's that everybody may write to; the test may go on as another user."""
    if os.geteuid() != 0:
        pytest.skip("only root can become another user")
    with tempfile.TemporaryDirectory() as name:
        Path(name).chmod(0o777)
        yield Path(name)
        os.seteuid(0)


def test_part_of_another_user_is_one_clear_line(open_folder: Path) -> None:
    log = open_folder / "a.mcap"
    killed_writer(log).chmod(0o600)
    os.seteuid(NOBODY)
    for force in (False, True):
        with pytest.raises(NameTaken, match=r"a\.mcap\.part: belongs to another user \(root\); choose"):
            reserve_log(log, force)
    with pytest.raises(LogError, match=r"a\.mcap\.part: belongs to another user \(root\); ask"):
        read_flight(log)
    assert names(open_folder) == ["a.mcap.part"]


def test_interrupted_part_of_another_user_is_not_removed(tmp_path: Path) -> None:
    if os.geteuid() != 0:
        pytest.skip("only root can give files to another user")
    for target in (tmp_path / "a.mcap", tmp_path / "a.html"):
        os.chown(killed_writer(target), NOBODY, NOBODY)
    with closing(reserve_log(tmp_path / "a.mcap", force=True)) as part:
        part.file.write(b"whole")
        part.publish()
    write_atomic(tmp_path / "a.html", "whole")
    assert names(tmp_path) == ["a.html", "a.html.part", "a.mcap", "a.mcap.part"]


def test_record_and_artefact_are_of_the_same_process(tmp_path: Path) -> None:
    target = tmp_path / "a.ref"
    with open_atomic(target, alone=True) as file:
        file.write(b"ours")
        for force in (False, True):
            with pytest.raises(UsageError, match="another process is writing it"):
                write_recorded(target, b"theirs", {"of": "theirs"}, force)
    assert names(tmp_path) == ["a.ref"]


def _reserve_next(folder: Path, start: Barrier, rounds: int) -> None:
    """Take the next free number in every round, as processes do that fly from one folder."""
    for _ in range(rounds):
        start.wait()
        for number in range(10 * rounds):
            try:
                part = reserve_log(folder / f"flight-{number}.mcap")
            except NameTaken:
                continue
            part.file.write(f"{os.getpid()}".encode())
            part.publish()
            part.close()
            break


def test_processes_that_reserve_at_once_get_a_name_each(tmp_path: Path) -> None:
    context, count, rounds = multiprocessing.get_context("fork"), 4, 50
    start = context.Barrier(count)
    processes = [context.Process(target=_reserve_next, args=(tmp_path, start, rounds)) for _ in range(count)]
    for process in processes:
        process.start()
    for process in processes:
        process.join()
    logs = [(tmp_path / f"flight-{number}.mcap").read_text() for number in range(count * rounds)]
    assert len(list(tmp_path.iterdir())) == count * rounds
    assert {pid: logs.count(pid) for pid in set(logs)} == {str(p.pid): rounds for p in processes}


def _write_in(folder: Path, start: Barrier) -> None:
    """Write the number of this process to two files of a folder that it has for itself, if it gets it."""
    start.wait()
    with suppress(NameTaken), own_folder(folder) as own:
        for name in ("a", "b"):
            write_atomic(own / name, f"{os.getpid()}")


def test_folder_that_processes_ask_for_at_once_is_written_by_one(tmp_path: Path) -> None:
    context, count = multiprocessing.get_context("fork"), 4
    for turn in range(20):
        start, folder = context.Barrier(count), tmp_path / f"{turn}"
        processes = [context.Process(target=_write_in, args=(folder, start)) for _ in range(count)]
        for process in processes:
            process.start()
        for process in processes:
            process.join()
        assert [process.exitcode for process in processes] == [0] * count
        assert len({path.read_text() for path in folder.iterdir()}) == 1


def test_folder_in_use_is_refused_and_an_empty_one_goes(tmp_path: Path) -> None:
    with own_folder(tmp_path / "out") as folder:
        for force in (False, True):
            with (
                pytest.raises(NameTaken, match="out: another process writes in this folder"),
                own_folder(folder, force),
            ):
                pass
    assert names(tmp_path) == []
    (tmp_path / "out").mkdir()
    with own_folder(tmp_path / "out"):
        pass
    assert names(tmp_path) == ["out"]
