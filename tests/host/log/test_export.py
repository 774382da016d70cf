"""A log as tables holds the same numbers."""

from __future__ import annotations

import csv
import io
from pathlib import Path

import pytest

from trimtab.host.log import LogError
from trimtab.host.log.export import TABLES, csv_tables


def test_export_makes_a_table_a_topic(log_path: Path) -> None:
    tables = csv_tables(log_path)
    assert tables["mocap-pose.csv"][0] == tables["fc-control.csv"][0] == 700
    assert set(tables) < set(TABLES)

    def read(name: str) -> list[dict[str, str]]:
        return list(csv.DictReader(io.StringIO(tables[name][1], newline="")))

    poses = read("mocap-pose.csv")
    assert (poses[3]["log_time_us"], poses[3]["publish_time_us"]) == ("34000", "30000")
    assert float(poses[3]["p_ned_m_0"]) == pytest.approx(0.03)
    control = read("fc-control.csv")
    assert control[0]["motor_mean_0"] == ""  # the first interval is invalid
    assert control[1]["motor_mean_3"] == "0.5"
    assert read("fc-status.csv")[0]["state"] == "TAKEOFF"
    text = read("log.csv")[0]
    assert text["message"] == "landed"
    assert text["timestamp_seconds"] == "6"


def test_export_of_a_cut_log_is_refused(tmp_path: Path, log_bytes: bytes) -> None:
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(log_bytes[:-50])
    with pytest.raises(LogError, match="recover"):
        csv_tables(cut)
