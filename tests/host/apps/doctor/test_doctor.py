"""The doctor on a sound machine, and on ones where a part is broken."""

from __future__ import annotations

import json
import os
import shlex
import sys
from pathlib import Path

import pytest

from trimtab.host import cli
from trimtab.host.apps.doctor import files, machine, packages, ports
from trimtab.host.apps.doctor.check import Check
from trimtab.host.apps.doctor.run import _done, all_checks
from trimtab.host.base import extras
from trimtab.host.codegen import find_compiler
from trimtab.host.workspace import make_workspace

BAD_ROUTE = 'name = "far"\nwaypoints_m = [[0, 0, -1], [1, 0, -1]]\nspede = 3\n'


@pytest.fixture
def space(tmp_path: Path) -> Path:
    make_workspace(tmp_path / "lab")
    return tmp_path / "lab"


def install(folder: Path, monkeypatch: pytest.MonkeyPatch, *requirements: str) -> None:
    """Put a Trimtab with these requirements before the installed one."""
    info = folder / "trimtab-9.0.dist-info"
    info.mkdir()
    lines = ["Metadata-Version: 2.1", "Name: trimtab", "Version: 9.0", "Requires-Python: >=3.11"]
    lines += [f"Requires-Dist: {requirement}" for requirement in requirements]
    (info / "METADATA").write_text("\n".join(lines) + "\n")
    monkeypatch.syspath_prepend(folder)


def status(checks: list[Check]) -> dict[str, str]:
    """The status of each check by name."""
    return {check.name: check.status for check in checks}


def test_sound_workspace_has_no_problem(space: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    found = status(all_checks(space))
    for name in ("python", "packages", "cache", "workspace", "output", "datagrams"):
        assert found.pop(name) in ("ok", "note"), name
    assert "problem" not in found.values()


def test_workspace_is_counted_and_an_empty_folder_is_none(space: Path, tmp_path: Path) -> None:
    (found, *_) = files.workspace(space)
    assert (found.status, found.text) == (
        "ok",
        f"{space} (vehicles 0, routes 1, controllers 0, effects 0)",
    )
    (tmp_path / "empty").mkdir()
    (none, *_) = files.workspace(tmp_path / "empty")
    assert none.status == "note"
    assert none.remedy == "run trimtab init FOLDER to make a workspace"


def test_bad_files_of_a_workspace_are_problems_and_exit_code_1(
    space: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (space / "routes" / "far.toml").write_text(BAD_ROUTE)
    (space / "vehicles" / "mine.toml").write_text("name = ")
    (space / "controllers" / "mine.toml").write_text("kind = 3\n")
    (space / "effects" / "slow_leak.py").write_text("EFFECT = 1 / 0\n")
    assert cli.main(["doctor", "--workspace", str(space), "--json"]) == 1
    printed = capsys.readouterr()
    told = json.loads(printed.out.splitlines()[-1])
    assert not told["works"]
    problems = [check for check in told["checks"] if check["status"] == "problem"]
    assert {check["name"] for check in problems} == {"routes", "vehicles", "controllers", "effects"}
    for name, part in (("routes", "far.toml"), ("vehicles", "mine.toml"), ("effects", "slow_leak.py")):
        assert any(check["name"] == name and part in check["text"] for check in problems)
    assert f"{len(problems)} of {len(told['checks'])} checks found a problem" in printed.err


def test_workspace_that_does_not_exist_is_a_problem(tmp_path: Path) -> None:
    (found,) = files.workspace(tmp_path / "nowhere")
    assert found.status == "problem"
    assert "nowhere: no such folder" in found.text


def test_cache_that_cannot_be_made_is_a_note_and_exit_code_0(
    space: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "file"))
    found = machine.cache()
    assert found.status == "note"
    assert "XDG_CACHE_HOME" in (found.remedy or "")
    assert cli.main(["doctor", "--workspace", str(space)]) == 0
    printed = capsys.readouterr()
    assert "note    cache: compiled code cannot be kept" in printed.out
    assert printed.err == ""


@pytest.mark.parametrize(
    ("uv", "command"),
    [
        ("/bin/uv", f"uv pip install --python {sys.executable}"),
        (None, f"pip --python {sys.executable} install"),
    ],
)
def test_missing_extra_of_a_python_without_pip_names_another_installer(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, uv: str | None, command: str
) -> None:
    install(tmp_path, monkeypatch, "no-such-reader>=1.3,<2; extra == 'logs'")
    monkeypatch.setattr(extras, "find_spec", lambda _: None)
    monkeypatch.setattr(extras.shutil, "which", lambda _: uv)
    assert extras.install_command("logs") == f"{command} 'no-such-reader>=1.3,<2'"


def test_missing_extra_is_a_note_that_names_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    optional = ("no-such-reader>=1.3; extra == 'logs'", "numpy; extra == 'watch'")
    install(tmp_path, monkeypatch, "numpy>=2", *optional)
    logs, watch, _ = packages.extras()
    assert (logs.name, logs.status) == ("extra logs", "note")
    assert logs.text.startswith("no-such-reader is not installed: no imports of PX4")
    assert logs.remedy == f"run {shlex.quote(sys.executable)} -m pip install 'no-such-reader>=1.3'"
    assert watch.status == "ok"
    assert packages.required().status == "ok"


def test_required_package_that_is_too_old_or_missing_is_a_problem(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    install(tmp_path, monkeypatch, "numpy>=99", "pydantic[email]>=2", "no-such-solver")
    found = packages.required()
    assert found.status == "problem"
    assert found.text.endswith(" is older than 99; no-such-solver is not installed")
    assert "pydantic" not in found.text


def test_every_extra_that_is_checked_exists() -> None:
    from importlib import metadata

    assert set(packages.EXTRAS) <= set(metadata.metadata("trimtab").get_all("Provides-Extra") or ())


@pytest.mark.parametrize(
    ("present", "bound", "older"),
    [
        ("1.9", "1.10", True),
        ("1.10.2rc1", "1.9", False),
        ("3.7", "3.7.0", False),
        ("2.0.1", "2", False),
        ("6.99", "7.35.1", True),
    ],
)
def test_versions_compare_by_number(present: str, bound: str, older: bool) -> None:
    assert packages.is_older(present, bound) is older


def test_check_that_needs_a_missing_package_is_a_problem() -> None:
    def run() -> list[Check]:
        import no_such_package  # noqa: F401  # pyright: ignore[reportMissingImports]

        return []

    (found,) = _done("ports", run)
    assert (found.name, found.status) == ("ports", "problem")
    assert "no_such_package" in found.text


def stand_in(folder: Path, monkeypatch: pytest.MonkeyPatch, script: str) -> None:
    """Make a program the only compiler."""
    (folder / "cc").write_text(f"#!/bin/sh\n{script}\n")
    (folder / "cc").chmod(0o755)
    monkeypatch.setenv("PATH", str(folder))


def test_compiler_that_fails_is_a_note_and_a_problem_where_c_is_asked_for(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("TRIMTAB_ENGINE", raising=False)
    stand_in(tmp_path, monkeypatch, "echo no licence >&2; exit 1")
    found = machine.compiled_code()
    assert found.status == "note"
    assert "the C compiler cc failed: no licence" in found.text
    monkeypatch.setenv("TRIMTAB_ENGINE", "c")
    assert machine.compiled_code().status == "problem"


def test_engine_without_a_compiler_is_a_note_and_an_unknown_one_a_problem(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setenv("TRIMTAB_ENGINE", "vm")
    assert machine.compiled_code().status == "note"
    monkeypatch.setenv("TRIMTAB_ENGINE", "fast")
    assert machine.compiled_code().status == "problem"


def test_compiled_code_names_the_lanes(monkeypatch: pytest.MonkeyPatch) -> None:
    if find_compiler() is None:
        pytest.skip("compiler: none found")
    monkeypatch.delenv("TRIMTAB_ENGINE", raising=False)
    found = machine.compiled_code()
    assert found.status == "ok"
    assert "doubles" in found.text


def test_little_room_is_a_note(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert machine.room("output", tmp_path).text.startswith(str(tmp_path))
    monkeypatch.setattr(machine, "FREE_MIN_BYTES", 1 << 62)
    assert machine.room("output", tmp_path).status == "note"


def test_serial_device_that_may_not_be_opened_names_the_group(tmp_path: Path) -> None:
    found = ports._permission(str(tmp_path / "ttyUSB0"))
    assert found.status == "note"
    assert "usermod -aG dialout $USER" in (found.remedy or "")
    assert ports._permission(os.devnull).status == "ok"


def test_machine_without_pseudo_terminals_has_a_problem(monkeypatch: pytest.MonkeyPatch) -> None:
    def none() -> tuple[int, int]:
        raise OSError("out of pty devices")

    monkeypatch.setattr(os, "openpty", none)
    found = ports.pseudo_terminal()
    assert found.status == "problem"
    assert "out of pty devices" in found.text
