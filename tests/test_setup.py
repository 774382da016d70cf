"""The set-up script on machines that lack parts, played by stand-ins for Python; nothing is downloaded."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent

STAND_IN = """#!/bin/sh
# Answers like a Python in which the named things do not work.
echo "$*" >>"{log}"
case "$*" in
*version_info*) exit {too_old} ;;
"-m venv --without-pip "*) [ {bare} = 0 ] && mkdir -p .venv/bin && cp "$0" .venv/bin/python; exit {bare} ;;
"-m venv "*) mkdir -p .venv/bin && cp "$0" .venv/bin/python; exit {venv} ;;
"-m pip --version") exit {pip} ;;
*) exit {install} ;;
esac
"""


def set_up(
    folder: Path, lock: str = "requirements.lock", /, **broken: int
) -> tuple[subprocess.CompletedProcess[str], list[str]]:
    """What `.ci/venv` does in `folder` with a stand-in Python, and the calls that one got."""
    (folder / ".ci").mkdir(exist_ok=True)
    shutil.copy(ROOT / ".ci" / "venv", folder / ".ci" / "venv")
    tools = folder / "tools"
    tools.mkdir(exist_ok=True)
    for name in ("sh", "dirname", "rm", "sed", "mkdir", "cp"):
        found = shutil.which(name)
        assert found is not None
        if not (tools / name).exists():
            (tools / name).symlink_to(found)
    log = folder / "calls"
    log.write_text("")
    answers = dict.fromkeys(("too_old", "bare", "venv", "pip", "install"), 0) | broken
    (tools / "python3").write_text(STAND_IN.format(log=log, **answers))
    (tools / "python3").chmod(0o755)
    done = subprocess.run(
        [str(folder / ".ci" / "venv"), lock, ".venv/stamp"],
        env={"PATH": str(tools)},
        capture_output=True,
        text=True,
        check=False,
    )
    return done, log.read_text().splitlines()


def test_venv_with_pip_installs_lock_then_checkout(tmp_path: Path) -> None:
    done, calls = set_up(tmp_path)
    assert done.returncode == 0, done.stderr
    installs = [call for call in calls if "install" in call]
    assert all("--quiet --quiet" in call for call in installs)  # not even warnings
    assert "--require-hashes -r requirements.lock" in installs[0]
    assert "--no-deps --no-build-isolation -e ." in installs[1]
    assert (tmp_path / ".venv" / "stamp").exists()


def test_another_lock_leaves_the_checkout_as_it_is_installed(tmp_path: Path) -> None:
    set_up(tmp_path)
    done, calls = set_up(tmp_path, "requirements-all.lock")
    assert done.returncode == 0, done.stderr
    (install,) = (call for call in calls if "install" in call)
    assert "--require-hashes -r requirements-all.lock" in install


def test_python_without_ensurepip_uses_the_systems_pip(tmp_path: Path) -> None:
    done, calls = set_up(tmp_path, venv=1)
    assert done.returncode == 0, done.stderr
    assert "-m venv --without-pip .venv" in calls
    installs = [call for call in calls if "install" in call]
    assert all("--python .venv/bin/python install --quiet --quiet" in call for call in installs)
    assert len(installs) == 2


@pytest.mark.parametrize("broken", [{"venv": 1, "pip": 1}, {"venv": 1, "bare": 1}])
def test_python_without_any_way_says_what_to_install(tmp_path: Path, broken: dict[str, int]) -> None:
    done, _ = set_up(tmp_path, **broken)
    assert done.returncode == 2
    assert "apt install python3-venv" in done.stderr
    assert not (tmp_path / ".venv").exists()


def test_old_python_is_refused_before_anything_is_made(tmp_path: Path) -> None:
    done, _ = set_up(tmp_path, too_old=1)
    assert done.returncode == 2
    assert "no Python 3.11 or newer found" in done.stderr
    assert not (tmp_path / ".venv").exists()


def test_failed_install_leaves_no_stamp_and_next_run_starts_anew(tmp_path: Path) -> None:
    done, _ = set_up(tmp_path, install=1)
    assert done.returncode != 0
    assert not (tmp_path / ".venv" / "stamp").exists()
    (tmp_path / ".venv" / "left-over").write_text("")
    done, _ = set_up(tmp_path)
    assert done.returncode == 0, done.stderr
    assert not (tmp_path / ".venv" / "left-over").exists()
    assert (tmp_path / ".venv" / "stamp").exists()


def test_changed_lock_updates_the_venv_in_place(tmp_path: Path) -> None:
    set_up(tmp_path)
    (tmp_path / ".venv" / "kept").write_text("")
    done, calls = set_up(tmp_path)
    assert done.returncode == 0, done.stderr
    assert (tmp_path / ".venv" / "kept").exists()
    assert not any("-m venv" in call for call in calls)
