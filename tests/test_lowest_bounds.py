"""The lower bounds in pyproject.toml: Trimtab runs with the lowest version of everything it depends on."""

from __future__ import annotations

import json
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
SMOKE = (
    ("--help",),
    ("trace", "--help"),
    ("plan", "figure-eight", "-o", "eight.ref", "--report", "eight.html"),
    ("fly", "eight.ref", "-o", "eight.mcap", "--json"),
    ("log", "info", "eight.mcap", "--json"),
)


def lowest() -> dict[str, str]:
    """The lowest version of each direct dependency, by name."""
    bounds = [re.fullmatch(r"([\w-]+)>=([\d.]+)", each) for each in PROJECT["dependencies"]]
    assert all(bounds), "a dependency without a single lower bound"
    return {match[1]: match[2] for match in bounds if match}


def run(*words: str | Path, folder: Path) -> str:
    """What a command prints; it must succeed."""
    done = subprocess.run(
        [str(word) for word in words], capture_output=True, text=True, check=False, cwd=folder
    )
    assert done.returncode == 0, f"{words}\n{done.stdout[-2000:]}\n{done.stderr[-4000:]}"
    return done.stdout


@pytest.mark.parametrize(
    "path", sorted((ROOT / "protocol" / "generated").glob("*_pb2.py")), ids=lambda p: p.name
)
def test_protobuf_bound_is_the_version_that_the_generated_code_demands(path: Path) -> None:
    demanded = re.search(r"^# Protobuf Python Version: (.*)$", path.read_text(encoding="utf-8"), re.MULTILINE)
    assert demanded is not None
    assert lowest()["protobuf"] == demanded[1]


@pytest.mark.full
@pytest.mark.long
def test_lowest_versions_plan_and_fly(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("PYTHONPATH", raising=False)
    monkeypatch.setenv("TRIMTAB_ENGINE", "vm")
    made = subprocess.run(
        [sys.executable, "-m", "venv", str(tmp_path / "venv")], capture_output=True, check=False
    )
    if made.returncode != 0:
        pytest.skip("venv: this Python can make no virtual environment")
    python = tmp_path / "venv" / "bin" / "python"
    versions = lowest()
    pip = (
        python,
        "-m",
        "pip",
        "--disable-pip-version-check",
        "install",
        "--quiet",
        "--no-input",
        "--no-compile",
    )
    run(*pip, *(f"{name}=={version}" for name, version in versions.items()), folder=tmp_path)
    run(sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", tmp_path / "wheel", folder=ROOT)
    run(*pip, "--no-deps", *(tmp_path / "wheel").iterdir(), folder=tmp_path)
    run(python, "-m", "pip", "check", folder=tmp_path)
    printed = [run(tmp_path / "venv" / "bin" / "trimtab", *words, folder=tmp_path) for words in SMOKE]
    flown, described = (json.loads(text.splitlines()[-1]) for text in printed[-2:])
    assert flown["whole"]
    assert described["id"] == flown["log_id"]
