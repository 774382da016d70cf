"""Blackbox headers: fields and rate, and why no such log can be imported."""

from __future__ import annotations

from pathlib import Path

import pytest

from trimtab.host.imports import ImportFormatError
from trimtab.host.imports.formats import betaflight, recognise

HEADER = (
    b"H Product:Blackbox flight data recorder by Nicholas Sherlock\n"
    b"H Field I name:loopIteration,time,gyroADC[0],motor[0]\n"
    b"H looptime:125\nH P interval:1/4\n"
)


def test_fields_and_rate_of_the_main_frames_are_told(tmp_path: Path) -> None:
    path = tmp_path / "LOG00001.BBL"
    path.write_bytes(HEADER + b"I\x00\x01" * 50)
    assert recognise(path) == "betaflight"
    topics = betaflight.contents(path).topics
    assert [topic.name for topic in topics] == ["loopIteration", "time", "gyroADC[0]", "motor[0]"]
    assert {topic.rate_hz for topic in topics} == {2000.0}
    with pytest.raises(ImportFormatError, match=r"LOG00001\.BBL: a Betaflight log holds no positions"):
        betaflight.read(path)


def test_damaged_names_are_told_in_one_line_without_control_characters(tmp_path: Path) -> None:
    path = tmp_path / "log"
    path.write_bytes(HEADER.replace(b"time", b"t\x1b[2J\0", 1))
    assert r"t\x1b[2J\x00" in [topic.name for topic in betaflight.contents(path).topics]


def test_header_without_fields_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "log"
    path.write_bytes(HEADER.replace(b"Field I name", b"Field J name"))
    with pytest.raises(ImportFormatError, match="log: the header names no fields"):
        betaflight.contents(path)
