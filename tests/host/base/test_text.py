"""File names that the locale cannot decode: read, written and named correctly by every verb."""

from __future__ import annotations

import json
import math
import os
import random
import shlex
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from trimtab.host.base import output
from trimtab.host.base.artefacts import content_id
from trimtab.host.base.text import ESCAPE, escaped, file_name, readable
from trimtab.host.log import read_flight
from trimtab.host.models.file import read_model

DATA = Path(__file__).parents[2] / "data"
LOCALE = {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}
COLUMNS = """
world = "nwu"
body = "flu"
time = "t"
position_m = ["x", "y", "z"]
quaternion = ["qw", "qx", "qy", "qz"]
thrust_n = "m"
"""
Run = Callable[..., tuple[int, dict[str, Any], str]]


def test_readable_takes_surrogates_for_bytes_of_utf_8() -> None:
    assert readable("n\udcc3\udcbc.mcap") == "nü.mcap"
    assert readable("nü.mcap") == "nü.mcap"
    assert readable("n\udcff") == "n\ufffd"
    assert readable("n\udcff", "surrogateescape") == "n\udcff"


def test_file_name_is_what_the_system_calls_the_file() -> None:
    assert os.fsencode(file_name("nü.npz")) == "nü.npz".encode()


def test_escape_writes_bytes_of_names_and_numbers_of_other_letters() -> None:
    assert "é n\udcc3\udcbc".encode("ascii", ESCAPE) == b"\\xe9 n\xc3\xbc"


@pytest.fixture
def run(tmp_path: Path) -> Run:
    """Runs a verb in an ASCII locale in the test's folder: exit code, the JSON object, stderr as UTF-8."""

    def call(*words: str) -> tuple[int, dict[str, Any], str]:
        done = subprocess.run(
            [sys.executable, "-m", "trimtab.host.cli", *words, "--json"],
            capture_output=True,
            check=False,
            cwd=tmp_path,
            env={**os.environ, **LOCALE, "XDG_CACHE_HOME": str(tmp_path / "cäche"), "TRIMTAB_ENGINE": "vm"},
        )
        assert b"Traceback" not in done.stderr
        return done.returncode, json.loads(done.stdout.splitlines()[-1]), done.stderr.decode()

    return call


def test_plan_and_flight_with_an_umlaut_are_written_and_named(run: Run, tmp_path: Path) -> None:
    code, answer, _ = run("plan", "figure-eight", "-o", "bahn-ü.ref", "--report", "bericht-ü.html")
    assert (code, answer["reference"], answer["report"]) == (0, "bahn-ü.ref", "bericht-ü.html")
    record = json.loads((tmp_path / "bahn-ü.ref.json").read_text("utf-8"))
    assert "bahn-ü.ref" in record["provenance"]["command"]
    assert "min-snap" in (tmp_path / "bericht-ü.html").read_text("utf-8")
    code, answer, _ = run("fly", "bahn-ü.ref", "-o", "flug-ü.mcap")
    assert (code, answer["log"]) == (0, "flug-ü.mcap")
    assert "bahn-ü.ref" in read_flight(tmp_path / "flug-ü.mcap").metadata["command"]
    code, answer, _ = run("log", "export", "flug-ü.mcap", "-o", "tabellen-ü")
    assert (code, answer["folder"]) == (0, "tabellen-ü")
    assert (tmp_path / "tabellen-ü" / "mocap-pose.csv").exists()


def test_trace_and_correction_with_an_umlaut_are_written_and_named(run: Run, tmp_path: Path) -> None:
    shutil.copy(DATA / "a1.mcap", tmp_path / "flüg.mcap")
    code, answer, complaint = run("trace", "flüg.mcap", "-o", "spur-ü")
    assert (code, answer["model"]) == (0, "spur-ü/trace.model.toml"), complaint
    assert "flüg.mcap" in (tmp_path / "spur-ü" / "trace.html").read_text("utf-8")
    assert "flüg.mcap" in json.dumps(answer, ensure_ascii=False)
    model = read_model(tmp_path / "spur-ü" / "trace.model.toml", vehicle_id=None)
    assert "flüg.mcap" in model.provenance["command"]
    code, answer, complaint = run("trace", "flüg.mcap", "flüg.mcap")
    assert (code, complaint) == (2, "trimtab: flüg.mcap: the same flight as flüg.mcap; give it once\n")
    assert answer["error"] == "flüg.mcap: the same flight as flüg.mcap; give it once"
    code, _, complaint = run("correct", "spur-ü/trace.model.toml", "-o", "ausgleich-ü.ff")
    assert code == 0, complaint


def test_model_with_an_umlaut_is_learned_and_read_again(run: Run, tmp_path: Path) -> None:
    shutil.copy(DATA / "a1.mcap", tmp_path / "flüg.mcap")
    learn = ("learn", "flüg.mcap", str(DATA / "c1.mcap"), "--epochs", "2", "--hidden", "4", "--as-asked")
    code, answer, complaint = run(*learn, "-o", "modell-ü.model.toml")
    assert (code, answer["model"]) == (0, "modell-ü.model.toml"), complaint
    plan = ("plan", "figure-eight", "--kind", "min-control-r", "--model", "modell-ü.model.toml")
    code, _, complaint = run(*plan, "-o", "bahn-ü.ref")
    assert code == 0, complaint


def test_imported_log_with_an_umlaut_names_its_source(run: Run, tmp_path: Path) -> None:
    noise = random.Random(4)
    rows = ["t,x,y,z,qw,qx,qy,qz,m"]
    for k in range(300):
        p = [noise.gauss(0.0, 1e-3) + x for x in (0.3 * math.sin(0.005 * k), 0.0, 1.0)]
        rows.append(",".join(f"{value:.6f}" for value in [0.01 * k, *p, 1.0, 0.0, 0.0, 0.0, 0.6]))
    (tmp_path / "flüge.csv").write_text("\n".join(rows))
    (tmp_path / "spalten-ü.toml").write_text(COLUMNS)
    words = ("import", "csv", "flüge.csv", "--columns", "spalten-ü.toml", "--vehicle", "nano")
    code, answer, complaint = run(*words, "-o", "flüge.mcap")
    assert (code, answer["log"]) == (0, "flüge.mcap"), complaint
    code, answer, _ = run("log", "info", "flüge.mcap")
    provenance = answer["provenance"]
    assert (code, provenance["source_file"]) == (0, "flüge.csv")
    assert shlex.split(provenance["command"]) == ["trimtab", *words]
    assert provenance["columns_id"] == content_id(COLUMNS.encode())


def test_missing_file_with_an_umlaut_is_named_on_stderr(run: Run) -> None:
    code, answer, complaint = run("log", "info", "nö.mcap")
    assert code == 2
    assert complaint == f"trimtab: {answer['error']}\n"
    assert complaint.startswith("trimtab: nö.mcap: cannot be read")


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("a\x1b[31mb\x00\x07", r"a\x1b[31mb\x00\x07"),
        ("a\nb\r\tc\x0b\x85\u2028\u2029", r"a\nb\r\tc\x0b\x85\u2028\u2029"),
        ("\x7f\x80\x9b", r"\x7f\x80\x9b"),
        ("\u202a\u202b\u202c\u202d\u202e\u2066\u2067\u2068\u2069", None),
        ("\u200b\u200c\u200d\u200e\u200f\u2060\ufeff\xad", None),
        ("\U000e0041", r"\U000e0041"),
        ("\ud800", r"\ud800"),
        ("n\udc9b\udcff", "n\\x9b\udcff"),
    ],
)
def test_escaped_shows_what_cannot_be_seen(text: str, shown: str | None) -> None:
    expected = "".join(f"\\u{ord(c):04x}" if ord(c) > 255 else f"\\x{ord(c):02x}" for c in text)
    assert escaped(text) == (expected if shown is None else shown)


@pytest.mark.parametrize(
    "text",
    [
        "Übung 3 (été).mcap",
        "日本\u3000語",
        "नमस्ते",
        "العَرَبِيَّة",
        "ภาษาไทย",
        "ħ µ ≤ € 🚁",
        "a\xa0b",
        r"back\x1b",
        "",
    ],
)
def test_escaped_leaves_letters_of_all_alphabets(text: str) -> None:
    assert escaped(text) == text
    assert escaped(f"{text}\n{text}", lines=True) == f"{text}\n{text}"


def test_output_shows_each_text_in_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    output.say("a\x1b]0;x\x07", "b\nc")
    output.warn("d\ne\u202e")
    printed = capsys.readouterr()
    assert printed.out == "a\\x1b]0;x\\x07\nb\\nc\n"
    assert printed.err == "trimtab: d\\ne\\u202e\n"


def test_json_keeps_the_text_and_escapes_it_itself(capsys: pytest.CaptureFixture[str]) -> None:
    for text in ("a\x1b\x7f\x9b\u202e\u200bé\n", "\x7f"):
        output.emit({"name": text}, True)
        printed = capsys.readouterr().out
        assert printed.removesuffix("\n").isascii()
        assert printed.removesuffix("\n").isprintable()
        assert json.loads(printed) == {"name": text}
