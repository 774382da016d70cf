"""What may be loaded as code: owners and modes of the file, of the folders above it, and of links to it."""

import os
import pickle
import pwd
import stat
from collections.abc import Callable
from pathlib import Path

import pytest

from trimtab.host.base import trust
from trimtab.host.base.trust import UntrustedError, distrust, read_code

STRANGER = 65534

as_root = pytest.mark.skipif(os.geteuid() != 0, reason="gives files to another user, which needs root")


@pytest.fixture
def code(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A file of this user's in two folders of theirs, outside the home folder."""
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    monkeypatch.setattr(trust, "_announced", set())
    folder = tmp_path / "lab" / "effects"
    folder.mkdir(parents=True)
    path = folder / "leak.py"
    path.write_text("A = 1\n")
    for each in (path, *path.parents[:2]):
        each.chmod(0o755)
    return path


def test_file_of_this_user_is_trusted(code: Path) -> None:
    assert distrust(code) is None
    assert read_code(code) == b"A = 1\n"


@pytest.mark.parametrize("which", [0, 1, 2])
@pytest.mark.parametrize("mode", [0o757, 0o775])
def test_file_that_others_can_change_is_not_trusted(code: Path, which: int, mode: int) -> None:
    place = (code, *code.parents)[which]
    if mode == 0o775:
        if os.geteuid() != 0:
            pytest.skip("gives a folder to another group, which needs root")
        os.chown(place, -1, STRANGER)
    place.chmod(mode)
    assert str(place) in (distrust(code) or "")
    with pytest.raises(UntrustedError, match=r"leak\.py: not run.*--trust") as raised:
        read_code(code)
    assert raised.value.exit_code == 2
    assert str(pickle.loads(pickle.dumps(raised.value))) == str(raised.value)
    assert read_code(code, trusted=True) == b"A = 1\n"


def test_private_group_of_the_owner_may_write(code: Path) -> None:
    import grp

    me = pwd.getpwuid(os.geteuid())
    group = grp.getgrgid(me.pw_gid)
    if group.gr_name != me.pw_name or set(group.gr_mem) - {me.pw_name}:
        pytest.skip("this user has no private group")
    os.chown(code, -1, me.pw_gid)
    code.chmod(0o664)
    assert distrust(code) is None


def test_sticky_folder_above_is_trusted_and_a_sticky_one_itself_is_not(code: Path) -> None:
    code.parents[1].chmod(0o1777)
    assert distrust(code.parent) is None
    assert distrust(code.parents[1]) is not None


@as_root
@pytest.mark.parametrize("which", [0, 1, 2])
def test_file_of_another_user_is_not_trusted(code: Path, which: int) -> None:
    place = (code, *code.parents)[which]
    os.chown(place, STRANGER, -1)
    assert distrust(code) == f"{place} belongs to {pwd.getpwuid(STRANGER).pw_name}"


@as_root
def test_other_user_trusts_files_of_root_and_not_those_of_a_third(
    code: Path, run_as: Callable[[Path], str]
) -> None:
    assert run_as(code) == "None"
    os.chown(code, 12345, -1)
    assert run_as(code) == f"{code} belongs to user 12345"


@pytest.fixture
def run_as(tmp_path: Path) -> Callable[[Path], str]:
    """What `distrust` returns in a process of the user STRANGER."""

    def run(path: Path) -> str:
        for folder in path.parents:  # pytest's folders are for their owner alone
            if stat.S_IMODE(folder.stat().st_mode) & 0o5 != 0o5:
                folder.chmod(0o755)
        read, write = os.pipe()
        child = os.fork()
        if child == 0:
            try:
                os.setuid(STRANGER)
                os.write(write, str(distrust(path)).encode())
            finally:
                os._exit(0)
        os.close(write)
        os.waitpid(child, 0)
        with os.fdopen(read) as pipe:
            return pipe.read()

    return run


@as_root
def test_link_to_a_file_of_this_user_in_a_strangers_folder_is_not_trusted(code: Path, tmp_path: Path) -> None:
    strange = tmp_path / "strange"
    strange.mkdir()
    os.chown(strange, STRANGER, -1)
    (strange / "effects").symlink_to(code.parent)
    assert distrust(strange / "effects" / "leak.py") is not None
    (code.parent / "other.py").symlink_to(strange / "x.py")
    (strange / "x.py").write_text("")
    assert distrust(code.parent / "other.py") is not None


@as_root
def test_folders_above_the_home_folder_are_not_checked(
    code: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    home = code.parents[1]
    outside = tmp_path / "homes"
    outside.mkdir()
    moved = home.rename(outside / "me")
    os.chown(outside, STRANGER, -1)
    assert distrust(moved / "effects" / "leak.py") is not None
    monkeypatch.setenv("HOME", str(moved))
    assert distrust(moved / "effects" / "leak.py") is None


def test_code_is_named_once_before_it_runs(code: Path, capsys: pytest.CaptureFixture[str]) -> None:
    read_code(code)
    read_code(code)
    assert capsys.readouterr().err == f"trimtab: runs the code in {code}\n"


def test_missing_file_is_an_os_error(code: Path) -> None:
    with pytest.raises(FileNotFoundError):
        read_code(code.with_name("none.py"))
