"""The command line's frame: help without imports, one line and a code for each kind of failure."""

from __future__ import annotations

import json
import os
import shlex
import subprocess
import sys
import types
from collections.abc import Callable
from contextlib import AbstractContextManager
from pathlib import Path

import pytest

from trimtab.host import cli
from trimtab.host.base import output
from trimtab.host.base.errors import (
    EXIT_CODES,
    FlightFailed,
    GateMissed,
    LinkError,
    SolverError,
    UsageError,
)
from trimtab.host.log import LogError
from trimtab.host.vehicle import ConfigurationError

HEAVY = ("numpy", "casadi", "scipy", "matplotlib", "pydantic", "pymavlink", "google", "rich", "cyclopts")


def run_python(code: str) -> str:
    """What a fresh interpreter prints for `code`."""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    return done.stdout


@pytest.fixture
def verb(monkeypatch: pytest.MonkeyPatch) -> Callable[[Callable[..., object]], None]:
    """A function that makes `trimtab probe` run the given command."""
    monkeypatch.setattr(output, "_emitted", False)

    def install(command: Callable[..., object]) -> None:
        module = types.ModuleType("trimtab.host.verbs.probe")
        vars(module)["command"] = command
        monkeypatch.setitem(sys.modules, "trimtab.host.verbs.probe", module)
        probe = cli.Verb(name="probe", module="probe", page="README.md", help="A verb of this test.")
        monkeypatch.setattr(cli, "VERBS", (probe,))

    return install


def test_help_imports_no_verb_and_nothing_heavy() -> None:
    printed = run_python(
        "import sys\nfrom trimtab.host.cli import main\nmain(['--help'])\n"
        f"print('LOADED', [m for m in {HEAVY!r} if m in sys.modules],"
        " [m for m in sys.modules if m.startswith('trimtab.host.verbs.')])"
    )
    assert "Close the gap" in printed
    assert printed.rstrip().endswith("LOADED [] []")


def test_min_snap_plan_and_its_flight_import_no_scipy_and_no_matplotlib(tmp_path: Path) -> None:
    reference, log = str(tmp_path / "hover.ref"), str(tmp_path / "hover.mcap")
    printed = run_python(
        f"import sys\nfrom trimtab.host.cli import main\nmain(['plan', 'hover', '-o', {reference!r}])\n"
        "print('LOADED', [m for m in ('scipy', 'matplotlib', 'pymavlink', 'google') if m in sys.modules])\n"
        f"main(['fly', {reference!r}, '-o', {log!r}])\n"
        "print('LOADED', [m for m in ('scipy', 'matplotlib', 'pymavlink') if m in sys.modules])"
    )
    assert [line for line in printed.splitlines() if line.startswith("LOADED")] == ["LOADED []"] * 2


@pytest.mark.parametrize(
    ("verb", "said"),
    [
        ("plan", "Reference to write. Default: NAME.ref"),
        ("fly", "Flight log to write. Default: NAME-FLIGHT.mcap"),
        ("demo", "trimtab-demo in the workspace"),
        ("learn", "[default: learned.model.toml]"),
        ("trace", "Without it, no file is written"),
        ("log recover", "Default: LOG.recovered.mcap"),
        ("vehicle new", "Default: vehicles/NAME.toml in the workspace"),
        ("log export", "Default: LOG.csv"),
    ],
)
def test_help_says_what_is_written_without_output(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, verb: str, said: str
) -> None:
    monkeypatch.setenv("COLUMNS", "200")
    assert cli.main([*verb.split(), "--help"]) == 0
    words = capsys.readouterr().out.replace("│", " ").split()  # wherever the lines break
    assert said in " ".join(words)


def test_version_is_the_packages(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["--version"]) == 0
    assert capsys.readouterr().out.strip() == cli._version()


def test_listed_verbs_have_modules_with_a_command() -> None:
    code = (
        "import importlib\nfrom trimtab.host.cli import VERBS\n"
        "for v in VERBS:\n"
        "    assert hasattr(importlib.import_module('trimtab.host.verbs.' + v.module), 'command'), v.name\n"
    )
    run_python(code)


def test_every_listed_verb_answers_help(capsys: pytest.CaptureFixture[str]) -> None:
    for listed in cli.VERBS:
        assert cli.main([listed.name, "--help"]) == 0, listed.name
        assert "Usage" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("error", "code"),
    [
        (GateMissed("low"), 1),
        (FlightFailed("failsafe"), 1),
        (UsageError("bad"), 2),
        (ConfigurationError(["v.toml: mass_kg: missing; add it"]), 2),
        (LinkError("no vehicle"), 3),
        (SolverError("gave up"), 4),
        (LogError("cut"), 5),
    ],
)
def test_known_error_is_one_line_and_its_code(
    verb: Callable[[Callable[..., object]], None],
    capsys: pytest.CaptureFixture[str],
    error: Exception,
    code: int,
) -> None:
    def command() -> None:
        raise error

    verb(command)
    assert cli.main(["probe"]) == code
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err == f"trimtab: {error}\n"
    assert code in EXIT_CODES


def test_every_problem_of_a_file_is_its_own_line(
    verb: Callable[[Callable[..., object]], None], capsys: pytest.CaptureFixture[str]
) -> None:
    def command() -> None:
        raise ConfigurationError(["v.toml: a: missing; add it", "v.toml: b: unknown key; remove it"])

    verb(command)
    assert cli.main(["probe"]) == 2
    assert capsys.readouterr().err.splitlines() == [
        "trimtab: v.toml: a: missing; add it",
        "trimtab: v.toml: b: unknown key; remove it",
    ]


def test_bug_is_one_line_that_names_a_file_with_the_traceback(
    verb: Callable[[Callable[..., object]], None],
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
) -> None:
    def command() -> None:
        raise KeyError("lost")

    verb(command)
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    assert cli.main(["probe"]) == 70
    (line,) = capsys.readouterr().err.splitlines()
    (saved,) = tmp_path.iterdir()
    assert str(saved) in line
    assert "a bug in trimtab: KeyError: 'lost'" in line
    assert 'raise KeyError("lost")' in saved.read_text()


def test_interrupt_ends_with_130(
    verb: Callable[[Callable[..., object]], None], capsys: pytest.CaptureFixture[str]
) -> None:
    def command() -> None:
        raise KeyboardInterrupt

    verb(command)
    assert cli.main(["probe"]) == 130
    assert capsys.readouterr().err == "trimtab: interrupted\n"


@pytest.mark.parametrize(
    ("when", "code", "said"),
    [
        ("sys.meta_path.insert(0, Finder())", 130, "trimtab: interrupted\n"),
        ("atexit.register(press)", 0, ""),
    ],
    ids=["while imports run", "at the interpreter's end"],
)
def test_interrupt_before_and_after_the_run_shows_no_traceback(when: str, code: int, said: str) -> None:
    program = f"""
import atexit, os, signal, sys
def press():
    os.kill(os.getpid(), signal.SIGINT)
class Finder:
    def find_spec(self, name, *of):
        if name == "cyclopts":
            press()
sys.argv = ["trimtab", "log", "--help"]
{when}
from trimtab.host.cli import main
sys.exit(main())
"""
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (code, said)


def test_missing_file_is_the_users_and_not_a_bug(
    verb: Callable[[Callable[..., object]], None], capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    def command() -> None:
        (tmp_path / "gone").read_text()

    verb(command)
    assert cli.main(["probe"]) == 2
    assert "gone: No such file or directory" in capsys.readouterr().err


def test_full_disk_is_the_users_and_not_a_bug(
    verb: Callable[[Callable[..., object]], None],
    capsys: pytest.CaptureFixture[str],
    full_disk: Callable[[int], AbstractContextManager[None]],
    tmp_path: Path,
) -> None:
    def command() -> None:
        (tmp_path / "big").write_bytes(bytes(2000))

    verb(command)
    with full_disk(1000):
        assert cli.main(["probe"]) == 2
    assert (
        capsys.readouterr().err == "trimtab: nothing more can be written: File too large; free disk space\n"
    )


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no /dev/full here")
@pytest.mark.parametrize("words", [["--version"], ["log", "info", "tests/data/a1.mcap", "--json"]])
def test_stdout_that_is_full_is_one_line(words: list[str]) -> None:
    with Path("/dev/full").open("w") as full:
        done = subprocess.run(
            [sys.executable, "-m", "trimtab.host.cli", *words],
            stdout=full,
            stderr=subprocess.PIPE,
            text=True,
            check=False,
            cwd=Path(__file__).parents[2],
        )
    assert done.returncode == 2
    assert done.stderr == "trimtab: nothing more can be written: No space left on device; free disk space\n"


def run_shell(line: str, folder: Path, **environment: str) -> subprocess.CompletedProcess[str]:
    """`line` in a shell in which `trimtab` runs this code."""
    script = f'trimtab() {{ {shlex.quote(sys.executable)} -m trimtab.host.cli "$@"; }}; {line}'
    root = str(Path(__file__).parents[2])
    return subprocess.run(
        ["sh", "-c", script],
        capture_output=True,
        text=True,
        check=False,
        cwd=folder,
        timeout=60,
        env={**os.environ, "PYTHONPATH": root, **environment},
    )


def test_help_whose_reader_has_gone_ends_quietly(tmp_path: Path) -> None:
    # The fifo makes sure that the reader has gone before anything is written.
    line = "mkfifo f gone; (exec 3<f; exec 3<&-; : >gone) & exec 4>f; : <gone; trimtab --help >&4"
    done = run_shell(line, tmp_path)
    assert (done.returncode, done.stderr) == (0, "")


@pytest.mark.parametrize("columns", ["0", "1", "20"])
def test_help_on_a_terminal_of_no_width_is_still_help(tmp_path: Path, columns: str) -> None:
    done = run_shell("trimtab log --help", tmp_path, COLUMNS=columns)
    assert (done.returncode, done.stderr) == (0, "")
    assert "Usage" in done.stdout


PLAN = "trimtab plan pretzel -o é.ref"


@pytest.mark.parametrize(
    "closed",
    [
        pytest.param(">&-", marks=pytest.mark.full),
        pytest.param("2>&-", marks=pytest.mark.full),
        "<&- >&- 2>&-",
    ],
)
def test_closed_stream_stops_no_verb(tmp_path: Path, closed: str) -> None:
    assert run_shell(f"{PLAN} {closed}", tmp_path).returncode == 0
    assert (tmp_path / "é.ref").stat().st_size > 0
    assert run_shell(f"{PLAN} {closed}", tmp_path).returncode == 2


def test_letters_that_stdout_lacks_are_written_as_numbers(tmp_path: Path) -> None:
    done = run_shell(PLAN, tmp_path, PYTHONIOENCODING="ascii")
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.startswith("\\xe9.ref: min-snap")


def test_verbs_return_value_is_the_exit_code(verb: Callable[[Callable[..., object]], None]) -> None:
    def command() -> int:
        return 1

    verb(command)
    assert cli.main(["probe"]) == 1


@pytest.mark.parametrize("words", [["nosuch"], ["probe", "--nosuch"], ["probe", "--count", "x"]])
def test_wrong_usage_is_one_line_and_2(
    verb: Callable[[Callable[..., object]], None], capsys: pytest.CaptureFixture[str], words: list[str]
) -> None:
    def command(*, count: int = 0) -> None:
        pass

    verb(command)
    assert cli.main(words) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("trimtab: ")
    assert "--help" in line


def test_failure_with_json_ends_in_one_object(
    verb: Callable[[Callable[..., object]], None], capsys: pytest.CaptureFixture[str]
) -> None:
    def command(*, json: bool = False) -> None:
        raise LinkError("no vehicle at the port")

    verb(command)
    assert cli.main(["probe", "--json"]) == 3
    told = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert told == {"error": "no vehicle at the port", "exit_code": 3}


def test_missed_gate_keeps_the_verbs_own_json_last(
    verb: Callable[[Callable[..., object]], None], capsys: pytest.CaptureFixture[str]
) -> None:
    def command(*, json: bool = False) -> None:
        output.emit({"rmse_m": 0.5}, json)
        raise GateMissed("0.5 m is above 0.1 m")

    verb(command)
    assert cli.main(["probe", "--json"]) == 1
    assert json.loads(capsys.readouterr().out.splitlines()[-1]) == {"rmse_m": 0.5}


def test_each_run_in_a_process_ends_in_an_object_of_its_own(capsys: pytest.CaptureFixture[str]) -> None:
    for _ in range(2):
        assert cli.main(["trace", "none.mcap", "--json"]) == 2
        assert json.loads(capsys.readouterr().out.splitlines()[-1])["exit_code"] == 2
