"""A workspace's own files come before the shipped ones."""

from __future__ import annotations

from pathlib import Path

import pytest

from host.errors import UsageError
from host.vehicle import load_vehicle
from host.workspace import open_workspace


def test_workspace_finds_own_and_shipped_files(tmp_path: Path) -> None:
    (tmp_path / "vehicles").mkdir()
    (tmp_path / "effects").mkdir()
    (tmp_path / "vehicles" / "mine.toml").write_text(load_vehicle("nano").replace(name="mine").to_toml())
    (tmp_path / "effects" / "slow_leak.py").write_text("")
    (tmp_path / "effects" / "_shared.py").write_text("")
    workspace = open_workspace(tmp_path)
    assert workspace.vehicle("mine").name == "mine"
    assert workspace.vehicle("research").name == "research"
    assert workspace.route("random:2").name == "random-2"
    assert workspace.effect_files() == {"slow-leak": tmp_path / "effects" / "slow_leak.py"}


def test_workspace_is_the_current_folder_unless_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert open_workspace().root == tmp_path


def test_missing_workspace_is_refused(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="no such folder"):
        open_workspace(tmp_path / "gone")
