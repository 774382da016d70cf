"""Control characters of names and texts from outside: escaped in terminal, log and page."""

from __future__ import annotations

import json
import re
import shutil
from pathlib import Path

import pytest

from tests.foreign import tables
from tests.foreign.flight import made_up
from trimtab.host import cli
from trimtab.host.base.text import escaped
from trimtab.host.log import LogWriter, Provenance, read_flight
from trimtab.host.log.provenance import PROVENANCE
from trimtab.host.log.scan import scan
from trimtab.host.log.topics import LOG
from trimtab.host.vehicle import load_vehicle

LOG_FILE = Path(__file__).parents[1] / "data" / "a1.mcap"
EVIL = "a\x1b[2J\x9b\n\u202eb\u200b"
"""An escape sequence, its short form, a line feed, a turn of the direction, and a space without width."""
SHOWN = r"a\x1b[2J\x9b\n\u202eb\u200b"


def _check_terminal(printed: str) -> None:
    for line in printed.split("\n"):
        assert escaped(line) == line
    assert r"a\x1b[2J\x9b" in printed
    assert r"\u202eb\u200b" in printed


@pytest.mark.parametrize(
    ("words", "code"),
    [
        (["log", "info", f"{EVIL}.mcap"], 0),
        (["log", "info", f"none-{EVIL}.mcap"], 2),
        (["plan", f"{EVIL}.toml"], 2),
        (["plan", f"none-{EVIL}"], 2),
        (["import", f"{EVIL}.csv"], 2),
        (["lineage", f"{EVIL}.mcap"], 0),
        (["compare", f"{EVIL}.mcap", f"{EVIL}.mcap"], 0),
        (["doctor"], 1),
        ([f"--{EVIL}"], 2),
    ],
    ids=lambda words: words[0].strip("-")[:8] if isinstance(words, list) else "",
)
def test_names_are_escaped_in_the_terminal(
    words: list[str],
    code: int,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    shutil.copy(LOG_FILE, f"{EVIL}.mcap")
    Path(f"{EVIL}.toml").write_text(f"{json.dumps(EVIL)} = 1\n")
    tables.write_csv(Path(f"{EVIL}.csv"), {EVIL.replace("\n", ""): made_up().t, "t": made_up().t})
    (tmp_path / "routes").mkdir()
    (tmp_path / "routes" / f"{EVIL}.toml").write_text("x = 1\n")
    assert cli.main(words) == code
    printed = capsys.readouterr()
    _check_terminal(printed.out + printed.err)
    if words[0] != f"--{EVIL}":
        assert cli.main([*words, "--json"]) == code
        last = capsys.readouterr().out.splitlines()[-1]
        assert last.isascii()
        assert last.isprintable()
        assert json.loads(last)


def test_text_of_a_vehicle_is_escaped_in_the_log(tmp_path: Path) -> None:
    vehicle = load_vehicle("research")
    provenance = Provenance(vehicle=vehicle, session={"command": f"trimtab fly {EVIL}"})
    with LogWriter(tmp_path / "a.mcap", provenance) as log:
        log.text(0, 0, 6, EVIL, "fc")
        log.text(1, 1, 6, "Übung", "fc")
    content = scan(tmp_path / "a.mcap")
    texts = [entry.data for entry in content.by_topic()[LOG]]
    assert SHOWN.encode() in texts[0]
    assert "Übung".encode() in texts[1]
    assert content.metadata[PROVENANCE]["command"] == f"trimtab fly {SHOWN}"


def test_names_are_escaped_on_the_page(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    shutil.copy(LOG_FILE, f"{EVIL}.mcap")
    assert cli.main(["show", f"{EVIL}.mcap", "--html", "page.html"]) == 0
    page = Path("page.html").read_text(encoding="utf-8")
    data = re.search(r'<script type="application/json" id="show-data">(.*?)</script>', page, re.DOTALL)
    assert data is not None
    for text in (page.replace(data[0], ""), json.dumps(json.loads(data[1]), ensure_ascii=False)):
        assert "\x1b" not in text
        assert "\\u001b" not in text
        assert "\u202e" not in text
        assert "\u200b" not in text
    assert SHOWN in json.dumps(json.loads(data[1])).replace("\\\\", "\\") or SHOWN in page


def test_card_of_a_flight_escapes_its_name(tmp_path: Path) -> None:
    shutil.copy(LOG_FILE, tmp_path / f"{EVIL}.mcap")
    card = read_flight(tmp_path / f"{EVIL}.mcap")._repr_html_()
    assert SHOWN.replace(r"\n", "\n") in card
