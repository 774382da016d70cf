"""The logs of a folder: closed, being written, and interrupted."""

from __future__ import annotations

from contextlib import closing
from pathlib import Path

import pytest

from trimtab.host.base.artefacts import reserve_log
from trimtab.host.base.parts import part_path
from trimtab.host.log import LogError, read_flight
from trimtab.host.log.listing import list_logs, listing_lines
from trimtab.host.log.mcap_file import MAGIC
from trimtab.host.log.scan import holds_chunk, scan


def test_listing_names_every_log_and_what_became_of_it(
    tmp_path: Path, log_path: Path, log_bytes: bytes
) -> None:
    (tmp_path / "broken.mcap").write_bytes(b"no log")
    part_path(tmp_path / "dead.mcap").write_bytes(log_bytes[: len(log_bytes) // 2])
    part_path(tmp_path / "early.mcap").write_bytes(log_bytes[:1000])
    with closing(reserve_log(tmp_path / "live.mcap")) as part, closing(reserve_log(tmp_path / "next.mcap")):
        part.file.write(log_bytes[:2000])
        listing = list_logs(tmp_path)
        lines = listing_lines(listing)
    logs = {Path(log["log"]).name: log for log in listing["logs"]}
    assert list(logs) == ["broken.mcap", log_path.name]
    assert logs[log_path.name]["id"] == read_flight(log_path).id
    assert "is not an MCAP file" in logs["broken.mcap"]["problem"]
    assert [(Path(each["log"]).name, each["bytes"], each["state"]) for each in listing["unfinished"]] == [
        ("dead.mcap", len(log_bytes) // 2, "interrupted"),
        ("early.mcap", 1000, "interrupted"),
        ("live.mcap", 2000, "writing"),
    ]
    assert [each["recoverable"] for each in listing["unfinished"]] == [True, False, False]
    assert len(lines) == 5
    assert lines[2].endswith(f"was interrupted; run `trimtab log recover {tmp_path / 'dead.mcap.part'}`")
    assert lines[3].endswith("interrupted before its first chunk; nothing can be recovered, remove it")
    assert lines[4].endswith("is being written")


def test_part_holds_a_chunk_from_the_end_of_its_first_one_on(tmp_path: Path, log_bytes: bytes) -> None:
    part = part_path(tmp_path / "a.mcap")
    outcomes = []
    for size in range(0, len(log_bytes), 997):
        part.write_bytes(log_bytes[:size])
        outcomes.append(holds_chunk(part))
        assert outcomes[-1] == (scan(part).chunks > 0 if size > len(MAGIC) else False)
    assert set(outcomes) == {False, True}


def test_listing_of_a_folder_without_logs_is_refused(tmp_path: Path) -> None:
    with pytest.raises(LogError, match="is a folder without a flight log"):
        list_logs(tmp_path)
