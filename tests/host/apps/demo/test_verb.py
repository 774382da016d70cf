"""`trimtab demo` before it begins: folder, seed and world."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from trimtab.host import cli
from trimtab.host.verbs.demo import free_folder


@pytest.fixture(autouse=True)
def _workspace(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def test_demo_in_a_world_nobody_knows_ends_at_once(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert cli.main(["demo", "--world", "nowhere", "--json"]) == 2
    told = capsys.readouterr()
    assert "nowhere: no such world" in told.err
    assert json.loads(told.out.splitlines()[-1])["exit_code"] == 2
    assert "1. plan" not in told.out
    assert not list(tmp_path.iterdir())


def test_demo_with_a_negative_seed_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["demo", "--seed", "-1"]) == 2
    assert "--seed -1 is negative" in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


def test_demo_into_a_folder_that_holds_files_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "kept").mkdir()
    (tmp_path / "kept" / "notes.txt").write_text("mine")
    assert cli.main(["demo", "-o", "kept"]) == 2
    assert "kept: is not empty; choose another folder or add --force" in capsys.readouterr().err
    assert cli.main(["demo", "-o", "kept/notes.txt"]) == 2
    assert "is a file; give a folder" in capsys.readouterr().err


def test_demo_without_a_folder_takes_the_next_free_name(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "trimtab-demo").mkdir()
    (tmp_path / "trimtab-demo" / "demo.html").write_text("an earlier one")
    with free_folder(tmp_path, None, force=True) as folder:
        assert folder == tmp_path / "trimtab-demo"
    with (
        free_folder(tmp_path, None, force=False) as folder,
        free_folder(tmp_path, None, force=False) as beside,
    ):
        assert (folder.name, beside.name) == ("trimtab-demo-2", "trimtab-demo-3")
    assert cli.main(["demo", "--world", "nowhere"]) == 2
    assert capsys.readouterr().out == ""
    assert [path.name for path in tmp_path.iterdir()] == ["trimtab-demo"]
    assert (tmp_path / "trimtab-demo" / "demo.html").read_text() == "an earlier one"
