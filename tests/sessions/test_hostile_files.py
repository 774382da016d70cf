"""Hostile files at the real command: one line, a documented exit code, little memory and processor time."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.foreign import hostile
from tests.foreign.hostile import MIB
from trimtab.host.base.bounds import (
    BAG_CHUNK_BYTES,
    BLOB_BYTES,
    CSV_LINE,
    DATAFLASH_JUNK,
    DATAFLASH_MESSAGES,
    LOG_CONTENT,
    LOG_MESSAGES,
    TOML_BYTES,
    TOML_DEPTH,
    ULOG_FIELDS,
    USD_RECORDS,
    WAYPOINTS,
    WEIGHTS_BYTES,
    Bound,
)
from trimtab.host.models.file import write_model
from trimtab.host.models.model import Model
from trimtab.host.models.network import Layout, Network
from trimtab.host.vehicle import load_vehicle

MEMORY_MB = 500
CPU_S = 20
"""Well above the 5 s that a refusal may take, since this machine may be slow."""
LAUNCHER = f"""
import os, resource, sys
resource.setrlimit(resource.RLIMIT_CPU, ({CPU_S}, {CPU_S}))
child = os.spawnv(os.P_NOWAIT, sys.argv[1], sys.argv[1:])
_, status, used = os.wait4(child, 0)
print(used.ru_maxrss)
sys.exit(os.waitstatus_to_exitcode(status))
"""
"""Runs a command under a limit and prints its peak memory, kB.

Linux counts the memory of the process that starts a command as the command's own, and pytest's is large.
"""
ROUTE = 'name = "a"\ntotal_time_s = 100.0\n'
LOG = Path(__file__).parents[1] / "data" / "a1.mcap"


def _route(text: str) -> Callable[[Path], list[str]]:
    def make(folder: Path) -> list[str]:
        (folder / "a.toml").write_text(ROUTE + text)
        return ["plan", "a.toml"]

    return make


def _import(name: str, content: bytes, format: str = "") -> Callable[[Path], list[str]]:
    def make(folder: Path) -> list[str]:
        (folder / name).write_bytes(content)
        return ["import", *format.split(), name]

    return make


def _log(content: bytes, count: int) -> Callable[[Path], list[str]]:
    def make(folder: Path) -> list[str]:
        (folder / "a.mcap").write_bytes(hostile.log_of_chunks(LOG.read_bytes(), count, content))
        return ["log", "info", "a.mcap"]

    return make


def _model(count: int | None, zeros_mib: int) -> Callable[[Path], list[str]]:
    def make(folder: Path) -> list[str]:
        import numpy as np

        layout = Layout(hidden=(32, 32))
        network = Network(layout=layout, xi=np.zeros(layout.size))
        craft = load_vehicle("research")
        model = Model(vehicle_id=craft.id, vehicle_name="research", network=network)
        write_model(model, folder / "a.model.toml")
        hostile.weights(folder / "a.model.npz", layout.size if count is None else count, zeros_mib)
        return ["show", "a.model.toml"]

    return make


def _sparse(name: str, *words: str, head: bytes = b"") -> Callable[[Path], list[str]]:
    def make(folder: Path) -> list[str]:
        hostile.sparse(folder / name, head)
        return [*words, name]

    return make


def _bag(folder: Path) -> list[str]:
    hostile.bag_of_chunks(folder / "a.mcap", 40)
    return ["import", "a.mcap"]


CASES: dict[str, tuple[Callable[[Path], list[str]], int, Bound | str]] = {
    "a key of 20,000 parts": (_route("x" + ".a" * 20_000 + " = 1\n"), 2, TOML_DEPTH),
    "brackets in brackets": (_route(f"x = {'[' * 20_000}\n"), 2, TOML_DEPTH),
    "a long TOML file": (_sparse("a.toml", "plan", head=b"#"), 2, TOML_BYTES),
    "many waypoints": (_route(f"waypoints_m = [{'[0, 0, -1], [1, 0, -1], ' * 1001}]\n"), 2, "at most 2000"),
    "many laps": (
        _route(f"closed = true\nlaps = 100\nwaypoints_m = [{'[0, 0, -1], [1, 0, -1], ' * 20}[1, 1, -1]]\n"),
        2,
        WAYPOINTS,
    ),
    "a reference of 4 GiB": (_sparse("a.ref", "export", "--format", "csv", "-o", "b.csv"), 2, BLOB_BYTES),
    "weights that unfold to 900 MiB": (_model(None, 900), 2, "another length"),
    "weights that declare 900 MiB": (_model(900 * MIB // 8, 900), 2, "of shape"),
    "weights of 4 GiB": (_model(None, 5), 2, WEIGHTS_BYTES),
    "chunks of large messages": (_log(hostile.messages(60, MIB), 40), 5, LOG_CONTENT),
    "chunks of small messages": (_log(hostile.messages(1_000_000, 0), 40), 5, LOG_MESSAGES),
    "a row without an end": (_sparse("a.csv", "import", "csv", head=b"t,x"), 5, CSV_LINE),
    "formats in formats": (_import("a.ulg", hostile.nested_ulog(3, 1000)), 5, ULOG_FIELDS),
    "messages without content": (_import("a.bin", hostile.tiny_messages(2_000_000)), 5, DATAFLASH_MESSAGES),
    "a DataFlash log of zeros": (
        _sparse("a.bin", "import", head=hostile.tiny_messages(1)), 5, DATAFLASH_JUNK
    ),
    "records without variables": (
        _import("log00", hostile.tiny_records(2_000_000), "crazyflie-usd"), 5, USD_RECORDS
    ),
    "a chunk of a bag of 1.25 GiB": (_bag, 5, BAG_CHUNK_BYTES),
}  # fmt: skip
"""What each file is: the words that read it, the exit code, and the bound or words that the message has."""

LIBRARIES = {"formats in formats": "pyulog", "a chunk of a bag of 1.25 GiB": "rosbags"}
"""Libraries that read a case."""


@pytest.mark.parametrize("case", CASES)
def test_hostile_file_is_refused_in_one_line_with_little_memory(case: str, tmp_path: Path) -> None:
    make, code, told = CASES[case]
    if case in LIBRARIES:
        library = LIBRARIES[case]
        pytest.importorskip(library, reason=f"{library} is not installed; pip install -e '.[logs]'")
    words = make(tmp_path)
    if case == "weights of 4 GiB":
        hostile.sparse(tmp_path / "a.model.npz", (tmp_path / "a.model.npz").read_bytes())

    done = subprocess.run(
        [sys.executable, "-S", "-c", LAUNCHER, sys.executable, "-m", "trimtab.host.cli", *words],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
    )
    line, peak_kb = done.stderr, int(done.stdout.splitlines()[-1])
    assert done.returncode == code, line
    assert line.count("\n") == 1
    assert "a." in line or "log00" in line
    assert (told if isinstance(told, str) else told.what) in line
    assert peak_kb < MEMORY_MB * 1024
