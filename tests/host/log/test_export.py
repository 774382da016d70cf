"""A log as tables holds the same numbers."""

from __future__ import annotations

import csv
from pathlib import Path

import pytest

from host.log import LogError
from host.log.export import export_csv


def _rows(path: Path) -> list[dict[str, str]]:
    with path.open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def test_export_writes_a_table_a_topic(tmp_path: Path, log_path: Path) -> None:
    written = export_csv(log_path, tmp_path / "tables")
    assert written["mocap-pose.csv"] == written["fc-control.csv"] == 700
    assert sorted(path.name for path in (tmp_path / "tables").iterdir()) == sorted(written)
    poses = _rows(tmp_path / "tables" / "mocap-pose.csv")
    assert (poses[3]["log_time_us"], poses[3]["publish_time_us"]) == ("34000", "30000")
    assert float(poses[3]["p_ned_m_0"]) == pytest.approx(0.03)
    control = _rows(tmp_path / "tables" / "fc-control.csv")
    assert control[0]["motor_mean_0"] == ""  # the first interval is invalid
    assert control[1]["motor_mean_3"] == "0.5"
    assert _rows(tmp_path / "tables" / "fc-status.csv")[0]["state"] == "TAKEOFF"
    text = _rows(tmp_path / "tables" / "log.csv")[0]
    assert text["message"] == "landed"
    assert text["timestamp_seconds"] == "6"


def test_export_of_a_cut_log_is_refused(tmp_path: Path, log_bytes: bytes) -> None:
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(log_bytes[:-50])
    with pytest.raises(LogError, match="recover"):
        export_csv(cut, tmp_path / "tables")
    assert not (tmp_path / "tables").exists()
