"""The logs of a folder: closed, being written, and interrupted."""

from __future__ import annotations

from contextlib import closing
from pathlib import Path

import pytest

from trimtab.host.base.artefacts import reserve_log
from trimtab.host.base.parts import part_path
from trimtab.host.log import LogError, read_flight
from trimtab.host.log.listing import list_logs, listing_lines


def test_listing_names_every_log_and_what_became_of_it(
    tmp_path: Path, log_path: Path, log_bytes: bytes
) -> None:
    (tmp_path / "broken.mcap").write_bytes(b"no log")
    part_path(tmp_path / "dead.mcap").write_bytes(log_bytes[:1000])
    with closing(reserve_log(tmp_path / "live.mcap")) as part, closing(reserve_log(tmp_path / "next.mcap")):
        part.file.write(log_bytes[:2000])
        listing = list_logs(tmp_path)
        lines = listing_lines(listing)
    logs = {Path(log["log"]).name: log for log in listing["logs"]}
    assert list(logs) == ["broken.mcap", log_path.name]
    assert logs[log_path.name]["id"] == read_flight(log_path).id
    assert "is not an MCAP file" in logs["broken.mcap"]["problem"]
    assert [(Path(each["log"]).name, each["bytes"], each["state"]) for each in listing["unfinished"]] == [
        ("dead.mcap", 1000, "interrupted"),
        ("live.mcap", 2000, "writing"),
    ]
    assert len(lines) == 4
    assert lines[2].endswith(f"was interrupted; run `trimtab log recover {tmp_path / 'dead.mcap.part'}`")
    assert lines[3].endswith("is being written")


def test_listing_of_a_folder_without_logs_is_refused(tmp_path: Path) -> None:
    with pytest.raises(LogError, match="is a folder without a flight log"):
        list_logs(tmp_path)
