"""The frame: skips and required parts, locks without addresses, documented exit codes."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

import pytest

from trimtab.host.base.errors import EXIT_CODES

ROOT = Path(__file__).parent.parent

PROBE = """
import pytest

def test_part(require):
    require("browser")

def test_reason():
    pytest.skip("because")

def test_silent():
    pytest.skip()
"""


def run_pytest(
    tmp_path: Path,
    source: str,
    *words: str,
    env: Mapping[str, str] | None = None,
    before: Sequence[str] = (),
) -> str:
    """Return the output of pytest with the project's conftest.py on one module.

    words: further arguments of pytest. env: changes of the environment. before: command that starts pytest.
    """
    shutil.copy(ROOT / "tests" / "conftest.py", tmp_path / "conftest.py")
    (tmp_path / "test_probe.py").write_text(source)
    command = [sys.executable, "-m", "pytest", "-p", "no:cacheprovider", "--rootdir", str(tmp_path)]
    done = subprocess.run(
        [*before, *command, *words, "."],
        cwd=tmp_path,
        env={**os.environ, **(env or {})},
        capture_output=True,
        text=True,
        check=False,
    )
    return done.stdout + done.stderr


def run_probe(tmp_path: Path, required: str) -> str:
    """What pytest says about PROBE, on a machine without a browser, with TRIMTAB_REQUIRE set."""
    env = {"TRIMTAB_REQUIRE": required, "PATH": str(tmp_path)}
    return run_pytest(tmp_path, PROBE, "-ra", "-q", env=env)


def test_missing_part_is_skipped_with_its_reason(tmp_path: Path) -> None:
    said = run_probe(tmp_path, "")
    assert "1 failed, 2 skipped" in said
    assert "browser: no chromium" in said
    assert "FAILED test_probe.py::test_silent - a skip must say why" in said


def test_missing_part_that_is_required_fails(tmp_path: Path) -> None:
    said = run_probe(tmp_path, "browser")
    assert "2 failed, 1 skipped" in said
    assert "TRIMTAB_REQUIRE names this part: browser" in said


@pytest.mark.parametrize(
    "head",
    [
        pytest.param("@pytest.mark.xdist_group('one')\n", id="by a mark"),
        pytest.param("@pytest.mark.realtime\n", id="in real time"),
        pytest.param(
            "@pytest.fixture(scope='module', autouse=True)\ndef shared():\n    pass\n\n", id="by a fixture"
        ),
    ],
)
def test_tests_of_a_group_share_a_worker(tmp_path: Path, head: str) -> None:
    source = (
        f"import pytest\n\n{head}"
        "@pytest.mark.parametrize('k', range(8))\n"
        "def test_it(k, worker_id):\n    print('ran on', worker_id)\n"
    )
    said = run_pytest(tmp_path, source, "-n", "2", "--dist", "loadgroup", "-rP")
    assert "8 passed" in said
    found = re.findall(r"^ran on (\w+)$", said, flags=re.MULTILINE)
    assert len(found) == 8
    assert len(set(found)) == 1


def test_run_in_the_background_of_a_shell_receives_sigint(tmp_path: Path) -> None:
    source = (
        "import signal\n\n"
        "def test_it():\n    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler\n"
    )
    ignoring = ("sh", "-c", "trap '' INT; exec \"$@\"", "sh")
    assert "1 passed" in run_pytest(tmp_path, source, before=ignoring)


def test_long_test_starts_before_the_others_of_its_size(tmp_path: Path) -> None:
    source = (
        "import pytest\n\ndef test_short():\n    pass\n\n"
        "@pytest.mark.long\ndef test_long():\n    pass\n\n"
        "@pytest.mark.parametrize('k', range(2))\n@pytest.mark.xdist_group('g')\n"
        "def test_group(k):\n    pass\n"
    )
    said = run_pytest(tmp_path, source, "-n", "1", "--dist", "loadgroup", "-v")
    assert "4 passed" in said
    order = re.findall(r"PASSED test_probe.py::test_(\w+)", said)
    assert order == ["group", "group", "long", "short"]


def test_unknown_required_part_stops_the_run(tmp_path: Path) -> None:
    assert "TRIMTAB_REQUIRE: unknown browsr; known: arm, browser, clients, compiler" in run_probe(
        tmp_path, "browsr"
    )


@pytest.mark.parametrize(
    "lock", [f"requirements{extra}.lock" for extra in ("", "-all", "-bench", "-clients")]
)
def test_lock_pins_by_hash_and_names_no_registry(lock: str) -> None:
    text = (ROOT / lock).read_text()
    assert "://" not in text
    assert not re.search(r"^--", text, flags=re.MULTILINE)
    pinned = re.findall(r"^[A-Za-z0-9._-]+==.*\\\n    --hash=sha256:[0-9a-f]{64}", text, flags=re.MULTILINE)
    assert len(pinned) == len(re.findall(r"^[A-Za-z0-9._-]+==", text, flags=re.MULTILINE)) > 30


def test_exit_codes_are_documented() -> None:
    page = (ROOT / "docs" / "reference" / "exit-codes.md").read_text()
    rows = dict(re.findall(r"^\| (\d+) \| (.+) \|$", page, flags=re.MULTILINE))
    assert rows == {str(code): meaning for code, meaning in EXIT_CODES.items()}
