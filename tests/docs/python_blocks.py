"""Run the Python blocks of a page in their order: `python tests/docs/python_blocks.py PAGE`."""

from __future__ import annotations

import re
import sys
from pathlib import Path


def script_of(text: str) -> str:
    """Return the Python blocks of a page, each on the lines that it has in the page."""
    lines = [""] * len(text.splitlines())
    for block in re.finditer(r"^```python\n(.*?)^```", text, flags=re.MULTILINE | re.DOTALL):
        first = text[: block.start(1)].count("\n")
        for k, line in enumerate(block[1].splitlines()):
            lines[first + k] = line
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    page = Path(sys.argv[1])
    exec(compile(script_of(page.read_text(encoding="utf-8")), str(page), "exec"), {"__name__": "__main__"})
