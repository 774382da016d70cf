"""The secret of a sealed study, and what a tracing process is given."""

from __future__ import annotations

import hashlib
import json
import os
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from trimtab.host.base.errors import UsageError
from trimtab.host.base.program import CHANGED
from trimtab.host.base.shards import Shard, ShardDone
from trimtab.sitl.studies import blind, commandline, flights
from trimtab.sitl.studies.commandline import bare_environment, run_apart
from trimtab.sitl.studies.files import StudyError, read_json
from trimtab.sitl.studies.flights import BLIND, FLIGHTS, VERDICT, Programme
from trimtab.sitl.studies.scoring.world import library
from trimtab.sitl.studies.secret import commitment, read_secret
from trimtab.sitl.studies.worlds import plan_worlds


def test_secret_is_made_once_with_256_bits_and_read_again(tmp_path: Path) -> None:
    one, two = (read_secret(tmp_path / name) for name in ("one", "two"))
    assert re.fullmatch("[0-9a-f]{64}", one)
    assert one != two
    assert read_secret(tmp_path / "one") == one
    assert (tmp_path / "one").stat().st_mode & 0o077 == 0
    assert commitment(one) == hashlib.sha256(one.encode("ascii")).hexdigest()


@pytest.mark.parametrize("text", ["", "7", "g" * 64, "a" * 63])
def test_file_with_anything_else_is_refused(tmp_path: Path, text: str) -> None:
    (tmp_path / "s").write_text(text)
    with pytest.raises(StudyError, match=r"--secret .*64 hex digits"):
        read_secret(tmp_path / "s")
    with pytest.raises(StudyError, match="cannot be read or made"):
        read_secret(tmp_path / "missing" / "s")


def test_every_bit_of_the_secret_counts_for_the_worlds() -> None:
    secret = int("ab" * 32, 16)
    assert plan_worlds(secret, 12, library()) == plan_worlds(secret, 12, library())
    kinds = [w.kinds for w in plan_worlds(secret, 60, library())]
    for bit in (0, 100, 255):
        other = plan_worlds(secret ^ (1 << bit), 60, library())
        assert [w.kinds for w in other] != kinds


def test_study_commits_to_its_secret_before_the_first_world(
    tmp_path: Path,
    short_programme: Programme,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """Nothing is flown here: the shard is one without worlds."""
    monkeypatch.setattr(blind, "plan_thin_references", lambda *_: None)
    monkeypatch.setattr(blind, "git_state", lambda: "0123456789ab")
    usual: dict[str, Any] = {"worlds": 6, "vehicle": "research", "jobs": 1, "programme": short_programme}
    usual |= {"folder": tmp_path / "state", "shard": Shard(index=99, count=99)}
    with pytest.raises(ShardDone):
        blind.run(seed=1, secret=tmp_path / "s", **usual)
    secret = read_secret(tmp_path / "s")
    recorded = (tmp_path / "state" / "study.json").read_text()
    assert json.loads(recorded)["secret_sha256"] == commitment(secret)
    assert json.loads(recorded)["program"]
    assert secret not in recorded
    assert commitment(secret) in capsys.readouterr().out
    with pytest.raises(UsageError, match="another secret_sha256"):
        blind.run(seed=1, secret=tmp_path / "other", **usual)


def test_secret_is_not_used_with_a_program_that_nobody_else_has(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(blind, "git_state", lambda: f"0123456789ab{CHANGED}")
    with pytest.raises(StudyError, match=r"--secret: .*not committed \(0123456789ab-dirty\); commit them"):
        blind.run(folder=tmp_path / "state", seed=1, vehicle="research", jobs=1, secret=tmp_path / "s")
    assert not list(tmp_path.iterdir())


def test_program_on_its_own_is_given_no_path_but_its_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("STUDY", str(tmp_path / "study"))
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(Path.cwd()), "."]))
    folder = tmp_path / "trace"
    folder.mkdir()
    code = "import os, json; print(json.dumps([dict(os.environ), os.getcwd()]))"
    done = subprocess.run(
        [sys.executable, "-c", code],
        cwd=folder,
        env=bare_environment(folder),
        capture_output=True,
        text=True,
        check=True,
    )
    environment, place = json.loads(done.stdout)
    assert place == str(folder.resolve())
    assert "study" not in json.dumps(environment)
    assert environment["PYTHONPATH"] == os.pathsep.join([str(Path.cwd())] * 2)
    # The command runs with it.
    assert run_apart(["log", "info", "missing.mcap"], folder, alone=True).code != 0


def test_tracing_process_cannot_name_the_study(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Everything that the process is given, while its verdict goes to the world's folder."""
    study = tmp_path / "study"
    (study / FLIGHTS).mkdir(parents=True)
    for log, _, _ in BLIND.flights():
        (study / FLIGHTS / f"{log}.mcap").write_bytes(b"")
    given: list[tuple[list[str], str, dict[str, str]]] = []
    run = subprocess.run

    def record(words: list[str], **options: Any) -> Any:
        given.append((words, str(options["cwd"]), options["env"]))
        return run([sys.executable, "-c", "print('{}')"], **options)

    monkeypatch.setattr(commandline.subprocess, "run", record)
    monkeypatch.setenv("OLDPWD", str(study))
    flights.trace(study, BLIND, few=True)
    assert len(given) == 3
    assert str(study) not in json.dumps(given)
    assert not any(Path(place).exists() for _, place, _ in given)
    assert read_json(study / VERDICT)["exit_code"] == 0


def test_temporary_folder_inside_the_study_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "state" / "tmp").mkdir(parents=True)
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path / "state" / "tmp"))
    with pytest.raises(StudyError, match="TMPDIR"):
        blind.run(folder=tmp_path / "state", seed=1, worlds=6, vehicle="research", jobs=1)
