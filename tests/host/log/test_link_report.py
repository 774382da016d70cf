"""What a log says of its link; whole flights over bad links are in tests/sessions."""

from __future__ import annotations

from pathlib import Path

from trimtab.host.log import read_flight
from trimtab.host.log.link_report import to_lines

DATA = Path(__file__).parent.parent.parent / "data"


def test_log_from_before_radios_were_logged_tells_what_it_knows() -> None:
    told = read_flight(DATA / "a1.mcap").to_dict()["link"]
    assert told["up_sent"] is told["down_lost_share"] is told["broken"] is told["mocap_age_ms_max"] is None
    assert told["frames_sent"] > told["frames_lost"] > 0
    assert 5.0 < told["rtt_ms"] <= told["rtt_ms_p99"] < 50.0
    assert 10.0 < told["mocap_age_ms_p50"] <= told["mocap_age_ms_p99"]
    lines = to_lines(told)
    assert f"{told['frames_sent']} frames" in lines[0]
    assert "? at most" in lines[1]
    assert not any("None" in line for line in lines)


def test_log_without_frames_or_poses_has_a_report_without_numbers(log_path: Path) -> None:
    told = read_flight(log_path).to_dict()["link"]
    assert told["frames_sent"] == 6900
    assert told["up_sent"] is None
    assert told["bytes_up_s"] == 0.0
    assert to_lines(told)
