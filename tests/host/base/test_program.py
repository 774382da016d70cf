"""The running program is identified by its source, with git or without."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from trimtab.host.base import program
from trimtab.host.base.program import git_state, program_id

ROOT = Path(__file__).parents[3]


@pytest.fixture
def copied(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A small program of four packages, which stands for the running one."""
    for package in ("firmware_model", "host", "protocol", "sitl"):
        (tmp_path / package).mkdir()
        (tmp_path / package / "one.py").write_text(f"NAME = '{package}'\n")
    monkeypatch.setattr(program, "_ROOT", tmp_path)
    return tmp_path


def fresh_id() -> str:
    program_id.cache_clear()
    try:
        return program_id()
    finally:
        program_id.cache_clear()


def test_program_id_changes_with_the_source_alone(copied: Path) -> None:
    before = fresh_id()
    assert len(before) == 12
    (copied / "host" / "__pycache__").mkdir()
    (copied / "host" / "__pycache__" / "one.pyc").write_bytes(b"compiled")
    (copied / "docs.md").write_text("not part of it")
    assert fresh_id() == before
    (copied / "host" / "one.py").rename(copied / "host" / "two.py")
    renamed = fresh_id()
    (copied / "host" / "two.py").write_text("NAME = 'changed'\n")
    assert len({before, renamed, fresh_id()}) == 3


def test_git_state_names_the_commit(require: Callable[[str], None]) -> None:
    require("git")
    state = git_state()
    if not (ROOT / ".git").exists():
        assert state is None
    else:
        assert state is not None
        assert len(state.removesuffix("-dirty")) == 12


def test_git_state_of_a_checkout_of_another_user_is_known(
    require: Callable[[str], None], copied: Path, tmp_path: Path
) -> None:
    require("git")
    if os.geteuid() != 0:
        pytest.skip("only root can give files to another user")
    git = ["git", "-C", str(copied), "-c", "user.name=a", "-c", "user.email=a@b"]
    for words in (["init", "-q"], ["add", "."], ["commit", "-q", "-m", "all"]):
        subprocess.run([*git, *words], check=True)
    state = git_state()
    assert state is not None
    for path in (copied, *copied.rglob("*")):
        os.chown(path, 65534, 65534)
    assert git_state() == state


def test_flight_has_the_same_bytes_with_and_without_git(
    tmp_path: Path, require: Callable[[str], None]
) -> None:
    require("git")
    words = [sys.executable, "-m", "trimtab.host.cli"]
    subprocess.run([*words, "plan", "hover", "-o", "a.ref"], cwd=tmp_path, check=True, capture_output=True)
    without = {**os.environ, "PATH": str(tmp_path / "nothing")}
    assert shutil.which("git", path=without["PATH"]) is None
    logs = []
    for environment in (dict(os.environ), without):
        fly = [*words, "fly", "a.ref", "-o", "a.mcap", "--force"]
        subprocess.run(fly, cwd=tmp_path, check=True, capture_output=True, env=environment)
        logs.append((tmp_path / "a.mcap").read_bytes())
    assert logs[0] == logs[1]
    assert b"program_id" in logs[0]
