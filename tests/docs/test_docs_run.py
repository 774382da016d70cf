"""Every command that the pages print works as printed, or its page says why it is not run."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.docs.page_commands import PAGES, ROOT, page_of
from tests.docs.python_blocks import script_of

TEXTS = {page.relative_to(ROOT).as_posix(): page.read_text(encoding="utf-8") for page in PAGES}
RUN = [name for name, text in TEXTS.items() if any(each.skipped is None for each in page_of(text).commands)]


@pytest.fixture(scope="module")
def workspace_after(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Path]:
    """Runs a page once, after the page that it continues: the folder that its commands leave."""
    left: dict[str, Path] = {}

    def run(name: str) -> Path:
        if name not in left:
            page, folder = page_of(TEXTS[name]), tmp_path_factory.mktemp("workspace")
            if page.continues is not None:
                before = (ROOT / name).parent / page.continues
                shutil.copytree(run(before.relative_to(ROOT).as_posix()), folder, dirs_exist_ok=True)
            for command in page.commands:
                if command.skipped is None:
                    run_command(command.text, folder)
            left[name] = folder
        return left[name]

    return run


def run_command(command: str, folder: Path) -> None:
    """Run a command as a shell does in a folder, which is its workspace. REPO is the repository."""
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    done = subprocess.run(
        command,
        shell=True,
        cwd=folder,
        env={**os.environ, "PATH": path, "REPO": str(ROOT)},
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, f"{command}\nexit code {done.returncode}\n{done.stdout}{done.stderr}"


@pytest.mark.full  # flights, traces and plans
@pytest.mark.long
@pytest.mark.parametrize("name", RUN)
def test_commands_of_page_run_as_printed(name: str, workspace_after: Callable[[str], Path]) -> None:
    workspace_after(name)


def test_pages_of_the_loop_are_run() -> None:
    assert {
        f"docs/guide/{name}.md"
        for name in ("first-flight", "tracing", "learning", "planning", "correction", "python")
    } <= {*RUN}


def test_python_blocks_of_a_page_keep_their_lines() -> None:
    page = "# A page\n\n```python\na = 1\n```\n\n    trimtab doctor\n\n```python\nb = a\nb = 1 / 0\n```\n"
    with pytest.raises(ZeroDivisionError) as caught:
        exec(compile(script_of(page), "page.md", "exec"), {})
    assert caught.traceback[-1].lineno + 1 == 11


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("<!-- not run: needs a vehicle -->\n\nNo block.\n\n    trimtab doctor\n", "no command follows"),
        ("    trimtab doctor\n\n<!-- not run: needs a vehicle -->\n", "no command follows"),
        ("    vehicles/mine.toml   trimtab plan window\n", "a command amid other text"),
    ],
)
def test_page_of_marks_that_belong_to_nothing_are_refused(text: str, complaint: str) -> None:
    with pytest.raises(ValueError, match=complaint):
        page_of(text)


def test_page_of_tells_commands_from_output_and_from_other_code() -> None:
    page = page_of(
        "<!-- continues: other.md -->\n\n# A page\n\n<!-- run:\nmkdir a\ntrimtab init\n-->\n\n"
        "    $ trimtab plan a\n    a.ref: trimtab plan\n\n"
        "1. In a list:\n\n<!-- not run: hardware -->\n<!-- run: trimtab fly a.ref -->\n\n"
        "       trimtab upload a.ref --port /dev/ttyUSB0\n\n"
        "```python\nimport trimtab  # trimtab plan\n```\n\n```\nmake demo\n```\n"
    )
    assert page.continues == "other.md"
    assert [(each.text, each.skipped, each.printed) for each in page.commands] == [
        ("mkdir a", None, False),
        ("trimtab init", None, False),
        ("trimtab plan a", None, True),
        ("trimtab fly a.ref", None, False),
        ("trimtab upload a.ref --port /dev/ttyUSB0", "hardware", True),
        ("make demo", None, True),
    ]
