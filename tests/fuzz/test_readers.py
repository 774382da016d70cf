"""Readers of foreign logs under damaged files; `make fuzz` gives each of them 10^5 and more."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.fuzz import readers

NEEDS = {"ulog": "pyulog", **dict.fromkeys(readers.BAGS, "rosbags")}
SLOW = ("dataflash", *readers.BAGS)
"""Readers that take some 10 ms for an input."""


def need(reader: str) -> None:
    if reader in NEEDS:
        pytest.importorskip(NEEDS[reader], reason=f"{NEEDS[reader]}: pip install 'trimtab[logs]'")


@pytest.mark.parametrize("reader", readers.READERS)
def test_damaged_log_is_read_or_refused_in_one_line_for_each_problem(reader: str) -> None:
    need(reader)
    inputs = 150 if reader in SLOW else 1_000
    valid, failures = readers.run(reader, inputs, seed=7)
    assert [failure.error for failure in failures] == []
    assert valid < inputs
    # Some damage does no harm, so the readers behind the checks were reached. Betaflight's only refuses.
    assert (valid > inputs // 20) == (reader != "betaflight")


@pytest.mark.parametrize("reader", [name for name in readers.READERS if name != "betaflight"])
def test_whole_log_is_read(reader: str, tmp_path: Path) -> None:
    need(reader)
    assert readers.give(reader, readers.whole_log(reader, tmp_path), tmp_path)


def test_fuzzer_tells_a_reader_that_breaks_the_rule(monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(name: str, path: Path, columns: Path | None) -> None:
        raise KeyError("timestamp")

    monkeypatch.setattr(readers.formats, "read", broken)
    valid, failures = readers.run("csv", 3, seed=7)
    assert valid == 0
    assert len(failures) == 3
    assert "KeyError" in failures[0].error
