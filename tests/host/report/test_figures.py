"""Figures of the reports, beside what the demo's and the trace's own tests say of them."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path


def test_figures_without_a_home_to_keep_a_cache_in_are_silent(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    nowhere = {
        "HOME": str(tmp_path / "file"),
        "XDG_CACHE_HOME": "",
        "XDG_CONFIG_HOME": "",
        "MPLCONFIGDIR": "",
    }
    done = subprocess.run(
        [sys.executable, "-c", "import trimtab.host.report.figures"],
        capture_output=True,
        text=True,
        check=False,
        env={**os.environ, **nowhere},
        cwd=Path(__file__).parents[3],
    )
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")
