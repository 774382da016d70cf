"""The commands that a page of the docs prints, and how its HTML comments say to run them.

    <!-- not run: REASON -->     the commands of the next block are not run
    <!-- run: COMMAND -->        a command that readers do not see, in its place; several on a line each
    <!-- continues: PAGE -->     the page begins in the workspace that this page leaves

A block is indented code, or fenced code without a language. Its commands begin with the name of a program. In
a block with prompts (`$ `) these are the lines with a prompt; the others are output.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[2]
PAGES = sorted([ROOT / "README.md", *(ROOT / "docs").rglob("*.md")])

_PROGRAM = r"(?:trimtab|make|python3?|mavproxy\.py|\.) (?=[\w./-])"
_TOKEN = re.compile(
    r"^[ ]*<!-- (?P<mark>not run|run|continues):\s+(?P<words>.*?)\s*-->"
    r"|^[ ]*```(?P<language>\w*)\n(?P<fenced>.*?)^[ ]*```"
    r"|(?P<indented>(?:^ {4,}\S[^\n]*\n)+)"
    r"|^(?P<text>[^\n]*\S[^\n]*)$",
    flags=re.MULTILINE | re.DOTALL,
)


@dataclass(frozen=True, kw_only=True)
class Command:
    """A command of a page. skipped: why it is not run, or None. printed: whether readers see it."""

    text: str
    skipped: str | None = None
    printed: bool = True


@dataclass(frozen=True, kw_only=True)
class Page:
    """The commands of a page in their order, and the page that it continues, or None."""

    commands: tuple[Command, ...]
    continues: str | None = None


def page_of(text: str) -> Page:
    """Return the commands of a page.

    Raises ValueError for a mark without a block, and for a command amid other text.
    """
    commands: list[Command] = []
    continues, reason = None, None
    for token in _TOKEN.finditer(text):
        mark, words = token["mark"], token["words"]
        block = token["indented"] or (token["fenced"] if token["language"] == "" else None)
        printed = [] if block is None else _commands(block)
        if reason is not None and mark != "run" and not printed:
            raise ValueError(f"no command follows the mark: not run: {reason}")
        if mark == "continues":
            continues = words
        elif mark == "not run":
            reason = words
        elif mark == "run":
            commands += [
                Command(text=line.strip(), printed=False) for line in words.splitlines() if line.strip()
            ]
        elif printed:
            commands += [Command(text=line, skipped=reason) for line in printed]
            reason = None
    if reason is not None:
        raise ValueError(f"no command follows the mark: not run: {reason}")
    return Page(commands=tuple(commands), continues=continues)


def _commands(block: str) -> list[str]:
    """Return the commands of a block of code."""
    lines = [line.strip() for line in block.splitlines()]
    if any(line.startswith("$ ") for line in lines):
        return [line.removeprefix("$ ") for line in lines if line.startswith("$ ")]
    for line in lines:
        if not re.match(_PROGRAM, line) and re.search(r"(?:^|\s)trimtab [a-z]", line):
            raise ValueError(f"a command amid other text: {line}")
    return [line for line in lines if re.match(_PROGRAM, line)]
