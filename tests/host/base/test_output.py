"""JSON for machines as the last line, progress only on a terminal."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from trimtab.host.base import output
from trimtab.host.base.live import LiveTable
from trimtab.host.base.progress import Progress


def test_json_is_one_line_with_plain_numbers(capsys: pytest.CaptureFixture[str]) -> None:
    output.say("a line for people")
    output.emit({"n": np.int64(3), "rmse": np.float64(0.5), "p": np.zeros(3), "log": Path("a.mcap")}, True)
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == "a line for people"
    assert json.loads(lines[-1]) == {"n": 3, "rmse": 0.5, "p": [0.0, 0.0, 0.0], "log": "a.mcap"}


def test_json_is_silent_where_not_asked_for(capsys: pytest.CaptureFixture[str]) -> None:
    output.emit({"n": 1}, False)
    assert capsys.readouterr().out == ""


@pytest.mark.parametrize("value", [float("nan"), np.inf])
def test_json_refuses_numbers_that_are_none(value: float) -> None:
    with pytest.raises(ValueError, match="not JSON compliant"):
        output.emit({"x": value}, True)


def test_warning_that_nobody_takes_stops_nothing() -> None:
    code = "from trimtab.host.base.output import warn; warn('one'); warn('two'); print('done')"
    with Path("/dev/full").open("w") as full:
        ended = subprocess.run([sys.executable, "-c", code], stdout=subprocess.PIPE, stderr=full, text=True)
    assert (ended.returncode, ended.stdout) == (0, "done\n")


def test_progress_without_a_terminal_says_nothing(capsys: pytest.CaptureFixture[str]) -> None:
    with Progress("plan", total=3) as progress:
        progress.advance(detail="one")
        progress.update(2, detail="two")
        progress.say("a line")
    captured = capsys.readouterr()
    assert (captured.out, captured.err) == ("", "")


def test_progress_on_a_terminal_goes_to_stderr(capsys: pytest.CaptureFixture[str]) -> None:
    with Progress("plan", total=3, enabled=True) as progress:
        progress.advance(detail="one")
        progress.say("a line")
    captured = capsys.readouterr()
    assert captured.out == ""
    assert "a line" in captured.err


def test_live_table_shows_rows_as_they_are_on_a_terminal_only(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("FORCE_COLOR", "1")  # rich takes the captured stream for a terminal
    for enabled, shown in ((None, False), (True, True)):
        with LiveTable("flight[1].mcap", enabled=enabled) as table:
            table.show([("phase", "tracking"), ("battery", "[bold]16.8 V")])
        told = capsys.readouterr()
        assert told.out == ""
        for words in ("flight[1].mcap", "tracking", "[bold]16.8 V"):
            assert (words in told.err) == shown
