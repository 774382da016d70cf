"""The wheel: what an index shows of it, and the pages that the help names. A full test installs it."""

from __future__ import annotations

import os
import re
import subprocess
import sys
import zipfile
from email.message import Message
from email.parser import Parser
from pathlib import Path

import pytest

from tests.docs.page_commands import PAGES, ROOT
from trimtab.host.cli import VERBS


@pytest.fixture(scope="module")
def unpacked(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the content of the wheel, as an installation has it."""
    folder = tmp_path_factory.mktemp("wheel")
    build = [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(folder)]
    subprocess.run(build, cwd=ROOT, capture_output=True, check=True)
    (wheel,) = folder.iterdir()
    with zipfile.ZipFile(wheel) as archive:
        archive.extractall(folder / "site")
    return folder / "site"


@pytest.fixture(scope="module")
def metadata(unpacked: Path) -> Message:
    (path,) = unpacked.glob("*.dist-info/METADATA")
    return Parser().parsestr(path.read_text(encoding="utf-8"))


def help_of(unpacked: Path, *words: str) -> str:
    """What the unpacked command prints as its help."""
    done = subprocess.run(
        [sys.executable, "-m", "trimtab.host.cli", *words, "--help"],
        capture_output=True,
        text=True,
        check=True,
        cwd=unpacked.parent,
        env={**os.environ, "PYTHONPATH": str(unpacked)},
    )
    return done.stdout


def test_description_is_the_readme_and_needs_no_picture(metadata: Message) -> None:
    assert metadata["Description-Content-Type"] == "text/markdown"
    text = str(metadata.get_payload())
    assert text.strip() == (ROOT / "README.md").read_text(encoding="utf-8").strip()
    for alternative in re.findall(r"!\[(.*?)\]", text):  # shown where the picture cannot be
        assert len(alternative.split()) > 3


def test_wheel_is_found_by_what_it_is(metadata: Message) -> None:
    assert "quadrotor" in metadata["Keywords"].split(",")
    classifiers = metadata.get_all("Classifier", [])
    assert "Programming Language :: Python :: 3" in classifiers
    assert not [name for name in classifiers if name.startswith("License")]  # License-Expression says it


def test_wheel_holds_every_page_and_what_the_pages_show(unpacked: Path) -> None:
    shipped = unpacked / "trimtab" / "docs"
    pages = [page.relative_to(ROOT / "docs") for page in PAGES if page.is_relative_to(ROOT / "docs")]
    assert len(pages) > 40
    for page in pages:
        text = (shipped / page).read_text(encoding="utf-8")
        for target in re.findall(r"\]\(([^)#:]+)\)", text):
            assert (shipped / page.parent / target).is_file(), (page, target)


def test_help_of_the_wheel_names_pages_that_are_in_it(unpacked: Path) -> None:
    docs = unpacked.resolve() / "trimtab" / "docs"
    assert help_of(unpacked).splitlines()[-1] == f"Documentation: {docs / 'README.md'}"
    for words in (["plan"], ["vehicle", "new"]):
        last = help_of(unpacked, *words).splitlines()[-1]
        page = Path(last.removeprefix("Guide: "))
        assert page.is_file()
        assert page.is_relative_to(docs)
    for verb in VERBS:
        assert (docs / verb.page).is_file(), verb.name
