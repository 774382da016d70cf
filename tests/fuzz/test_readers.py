"""Damaged foreign logs for every reader, 10^5 each in `make fuzz`; what their fuzzer must notice."""

from __future__ import annotations

import subprocess
import sys
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from tests.fuzz import readers
from tests.fuzz.readers import READERS, input_of, main, run
from trimtab.host.imports import ImportFormatError
from trimtab.host.imports.contents import Contents, Topic
from trimtab.host.imports.formats import betaflight

INPUTS = 700
SEED = 20_261
ROOT = Path(__file__).parents[2]
FEWEST_READ = {"betaflight": 0, "bag": 100, "mcap": 100}
"""Flights that are read nevertheless; a blackbox log holds none."""


@pytest.mark.parametrize("name", READERS)
def test_damaged_logs_are_read_or_refused_in_one_line(name: str) -> None:
    library = READERS[name].library
    if library is not None:
        pytest.importorskip(library, reason=f"{library} is not installed; pip install -e '.[logs]'")
    report = run(name, INPUTS, SEED)
    assert [f"{name}:{crash.index} {crash.error}" for crash in report.crashes] == []
    assert report.inputs == INPUTS
    assert report.told > INPUTS // 20
    assert report.read >= FEWEST_READ.get(name, INPUTS // 6)


def test_input_depends_on_reader_seed_and_index_alone() -> None:
    assert input_of("csv", 3, 17) == input_of("csv", 3, 17)
    assert len({input_of("csv", seed, index) for seed in (3, 4) for index in range(20)}) > 35


# What it must notice: each fault is put into a real reader.


def _raises(path: Path) -> Contents:
    raise KeyError(path.name)


def _warns(path: Path) -> Contents:
    warnings.warn("divide by zero", RuntimeWarning, stacklevel=1)
    return Contents(topics=(), duration_s=0.0)


def _leaks(path: Path) -> Contents:
    path.open("rb")
    return Contents(topics=(), duration_s=0.0)


def _prints(path: Path) -> Contents:
    print("bad header")
    return Contents(topics=(), duration_s=0.0)


def _hangs(path: Path) -> Contents:
    while True:
        pass


def _refuses(line: str) -> Callable[[Path], Contents]:
    def contents(path: Path) -> Contents:
        raise ImportFormatError(line)

    return contents


def _tells(name: str, rate_hz: float) -> Callable[[Path], Contents]:
    topic = Topic(name=name, count=1, rate_hz=rate_hz)
    return lambda path: Contents(topics=(topic,), duration_s=1.0)


@pytest.mark.parametrize(
    ("fault", "error"),
    [
        (_raises, "KeyError: 'a.bbl'"),
        (_warns, "warns: RuntimeWarning: divide by zero"),
        (_leaks, "warns: ResourceWarning"),
        (_prints, "prints 'bad header"),
        (_hangs, "Hanging: more than 0.05 s"),
        (_refuses("a.bbl: damaged;\ncopy it again"), "not one line"),
        (_refuses("damaged; copy it again"), "not one line"),
        (_tells("a", float("inf")), "impossible numbers"),
        (_tells("a\x1b[2J", 1.0), "not printable"),
    ],
)
def test_fault_of_a_reader_is_found(
    monkeypatch: pytest.MonkeyPatch, fault: Callable[[Path], Contents], error: str
) -> None:
    monkeypatch.setattr(readers, "CPU_S", 0.05)
    monkeypatch.setattr(betaflight, "contents", fault)
    assert error in run("betaflight", 1, SEED).crashes[0].error


def test_memory_that_a_reader_needs_is_found() -> None:
    program = (
        "from tests.fuzz import readers\n"
        "from trimtab.host.imports.formats import betaflight\n"
        "betaflight.contents = lambda path: bytearray(b'x') * 400_000_000\n"
        "readers._check_contents = lambda contents: None\n"
        "print(readers.run('betaflight', 1, 0).crashes[0].error)\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", program], cwd=ROOT, capture_output=True, text=True, check=True
    )
    assert "memory grew by" in done.stdout


def test_crash_is_saved_and_replayed(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Any
) -> None:
    monkeypatch.setattr(betaflight, "contents", _raises)
    words = ["--readers", "betaflight", "--seed", "6"]
    assert main([*words, "--inputs", "2", "--save", str(tmp_path)]) == 1
    saved = (tmp_path / "fuzz-betaflight-6-0.hex").read_text().strip()
    assert bytes.fromhex(saved) == input_of("betaflight", 6, 0).log
    with pytest.raises(KeyError):
        main([*words, "--replay", "betaflight:0"])
    monkeypatch.undo()
    assert main([*words, "--replay", "betaflight:0"]) == 0
    assert "betaflight: 2 inputs, 0 with contents, 0 flights read, 1 crashes" in capsys.readouterr().out
