"""Files are written whole or not at all, never over another one, and say where they come from."""

from __future__ import annotations

import hashlib
import json
import os
import shlex
import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager
from pathlib import Path

import pytest

from trimtab.host import cli
from trimtab.host.base.artefacts import (
    check_folder,
    check_output,
    content_id,
    open_atomic,
    provenance,
    public_command,
    reserve_log,
    without_options,
    write_atomic,
)
from trimtab.host.base.errors import UsageError


def test_write_leaves_the_file_and_nothing_else(tmp_path: Path) -> None:
    path = write_atomic(tmp_path / "a.ref", b"bytes")
    assert path.read_bytes() == b"bytes"
    assert [entry.name for entry in tmp_path.iterdir()] == ["a.ref"]


def test_write_refuses_an_existing_file_unless_forced(tmp_path: Path) -> None:
    path = write_atomic(tmp_path / "a.toml", "first")
    with pytest.raises(UsageError, match="exists; choose another name or add --force"):
        write_atomic(path, "second")
    assert path.read_text() == "first"
    write_atomic(path, "second", force=True)
    assert path.read_text() == "second"


def write_half(path: Path, error: BaseException, force: bool = False) -> None:
    """Start to write `path`, then raise `error`."""
    with open_atomic(path, force) as file:
        file.write(b"half")
        raise error


@pytest.mark.parametrize("error", [ValueError(), KeyboardInterrupt()])
def test_interrupted_write_leaves_nothing(tmp_path: Path, error: BaseException) -> None:
    with pytest.raises(type(error)):
        write_half(tmp_path / "a.mcap", error)
    assert list(tmp_path.iterdir()) == []


def test_interrupted_forced_write_keeps_the_old_file(tmp_path: Path) -> None:
    path = write_atomic(tmp_path / "a.mcap", b"old")
    with pytest.raises(ValueError, match="stop"):
        write_half(path, ValueError("stop"), force=True)
    assert path.read_bytes() == b"old"


def test_file_made_meanwhile_is_not_overwritten(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    writing = open_atomic(path)
    writing.__enter__().write(b"ours")
    path.write_bytes(b"theirs")
    with pytest.raises(UsageError, match="exists"):
        writing.__exit__(None, None, None)
    assert path.read_bytes() == b"theirs"


def test_output_in_missing_folder_or_onto_folder_is_refused(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="its folder does not exist"):
        check_output(tmp_path / "gone" / "a.ref")
    with pytest.raises(UsageError, match="is a folder"):
        check_output(tmp_path, force=True)


@pytest.fixture
def read_only() -> Iterator[Path]:
    """A folder that this process may not write to; root gives its privileges up meanwhile."""
    folder = Path(tempfile.mkdtemp())
    folder.chmod(0o555)
    root = os.geteuid() == 0
    if root:
        os.seteuid(65534)
    yield folder
    if root:
        os.seteuid(0)
    folder.rmdir()


def test_output_in_a_read_only_folder_is_refused_before_the_work(read_only: Path) -> None:
    for check in (check_output, reserve_log, lambda path: check_folder(path, ())):
        with pytest.raises(UsageError, match=r"a\.mcap: its folder cannot be written to; choose another"):
            check(read_only / "a.mcap")


def test_file_that_cannot_be_made_is_named_and_not_its_temporary_name(tmp_path: Path) -> None:
    longest = tmp_path / ("a" * 255)
    with pytest.raises(OSError, match="too long") as caught:
        write_atomic(longest, "text")
    assert caught.value.filename == str(longest)


def test_write_onto_a_full_disk_names_the_file_and_leaves_nothing(
    tmp_path: Path, full_disk: Callable[[int], AbstractContextManager[None]]
) -> None:
    path = tmp_path / "a.ref"
    with full_disk(1000), pytest.raises(OSError, match=r"a\.ref"):
        write_atomic(path, bytes(2000))
    assert list(tmp_path.iterdir()) == []


def test_content_id_is_the_hash_s_start() -> None:
    assert content_id(b"abc") == hashlib.sha256(b"abc").hexdigest()[:12] == "ba7816bf8f01"


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ("fly /tmp/x/a.ref --world w --seed 3 --world-seed=9 -o /tmp/o.mcap", "fly a.ref --seed 3 -o o.mcap"),
        ("fly a.ref --plant=p.py:P --plant-options o.toml --flight 2", "fly a.ref --flight 2"),
        ("fly a.ref --world_seed 9 --flight 2", "fly a.ref --flight 2"),
        ("fly a.ref --world_seed=9 --plant_options o.toml --plant=p.py:P", "fly a.ref"),
        ("demo --seed 77 --world w", "demo"),
        ("plan pretzel --model=/home/me/m.toml", "plan pretzel --model=m.toml"),
        ("sitl --truth t.json --port pty", "sitl --port pty"),
    ],
)
def test_public_command_leaves_out_world_and_folders(words: str, said: str) -> None:
    assert public_command(words.split()) == f"trimtab {said}"


def test_public_command_is_quoted_for_a_shell() -> None:
    words = ["fly", "my plan.ref", "--parameter", "A=1", "--vehicle=lab 3/mine.toml"]
    said = public_command(words)
    assert said == "trimtab fly 'my plan.ref' --parameter A=1 '--vehicle=lab 3/mine.toml'"
    assert shlex.split(said) == ["trimtab", *words]


def test_command_of_a_call_from_python_is_recorded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("sys.argv", ["script.py", "--its-own"])
    assert cli.main(["plan", "hover", "-o", "hover.ref"]) == 0
    assert sys.argv == ["script.py", "--its-own"]
    record = json.loads((tmp_path / "hover.ref.json").read_text())
    assert record["provenance"]["command"] == "trimtab plan hover -o hover.ref"


@pytest.mark.parametrize(
    "words",
    ["-o x.mcap", "-ox.mcap", "-o=x.mcap", "--output x.mcap", "--output=x.mcap", "--json", "--as_flashed"],
)
def test_options_are_left_out_in_every_spelling(words: str) -> None:
    given = ["fly", "a.ref", *words.split(), "--start", "-1"]
    left = without_options(given, ("-o", "--output"), ("--json", "--as-flashed"))
    assert left == ["fly", "a.ref", "--start", "-1"]


def test_provenance_has_no_time_and_no_path(tmp_path: Path) -> None:
    record = provenance(seed=4, parents={"vehicle": "0123456789ab"}, argv=["plan", str(tmp_path / "r.toml")])
    assert record["version"].count(".") == 2
    assert record["command"] == "trimtab plan r.toml"
    assert record["seed"] == 4
    assert record["parents"] == {"vehicle": "0123456789ab"}
    assert str(tmp_path) not in str(record)
    assert record == provenance(
        seed=4, parents={"vehicle": "0123456789ab"}, argv=["plan", str(tmp_path / "r.toml")]
    )


def test_folder_is_checked_without_being_made(tmp_path: Path) -> None:
    folder = tmp_path / "out"
    assert check_folder(folder, ("a.html", "b.json")) == folder
    assert list(tmp_path.iterdir()) == []
    folder.mkdir()
    write_atomic(folder / "b.json", "mine")
    with pytest.raises(UsageError, match=r"b\.json: exists; choose another name or add --force"):
        check_folder(folder, ("a.html", "b.json"))
    check_folder(folder, ("a.html", "b.json"), force=True)
    with pytest.raises(UsageError, match="is a file"):
        check_folder(folder / "b.json", ("a.html",))
    deep = tmp_path / "no" / "out"
    assert check_folder(deep, ("a.html",)) == deep
    with pytest.raises(UsageError, match=r"out/b\.json is a file; choose another folder"):
        check_folder(folder / "b.json" / "deep" / "deeper", ("a.html",))
