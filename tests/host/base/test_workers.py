"""Calls in several processes: results in order, and errors as in one process."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from trimtab.host.base.parallel import cores
from trimtab.host.base.workers import workers


@pytest.mark.parametrize("jobs", [1, 2])
def test_workers_return_results_and_raise_errors_in_order(jobs):
    with workers(jobs) as pool:
        results = [pool.submit(pow, 2, number) for number in range(3)]
        failed = pool.submit(int, "x")
        here = pool.submit(os.getpid)
        assert [future.result() for future in results] == [1, 2, 4]
        with pytest.raises(ValueError, match="'x'"):
            failed.result()
        assert (here.result() == os.getpid()) == (jobs == 1)


def test_cores_are_those_of_this_process():
    assert cores() >= 1


ORPHANED = """
import signal, sys
from pathlib import Path
from trimtab.host.base.pieces import Piece, run_pieces
from trimtab.host.base.workers import workers

def block(*_):
    sys.stdout.write("blocked\\n")  # in one piece, unlike print, as two processes write
    sys.stdout.flush()
    signal.pause()

if __name__ == "__main__":
    if sys.argv[1] == "workers":
        with workers(2) as pool:
            pool.submit(block).result()
    pieces = [Piece(name=name, kind="piece", arguments={}) for name in "ab"]
    run_pieces(pieces, block, folder=Path(sys.argv[2]), config={}, jobs=2)
"""


@pytest.mark.parametrize("pool", ["workers", "pieces"])
def test_workers_end_when_their_parent_is_killed(tmp_path: Path, pool: str) -> None:
    """The pipe ends only when no process holds it any more."""
    (tmp_path / "run.py").write_text(ORPHANED)
    command = [sys.executable, str(tmp_path / "run.py"), pool, str(tmp_path / "study")]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "blocked\n"
        process.kill()
        assert set(process.stdout.read().split()) <= {"blocked"}
