"""Generate docs/reference/bounds.md, on the bounds of what is read from files, from the table of them.

`python docs/generators/bounds.py FILE` writes it. A test compares the page with the code.
"""

from __future__ import annotations

import sys
from pathlib import Path

from trimtab.host.base.bounds import BOUNDS, MIB, Bound

_HEAD = """# Bounds of files

<!-- Made by `make docs` from host/base/bounds.py; change it there. -->

A file may come from a stranger, or be damaged. A reader of Trimtab therefore looks at sizes before contents:
first at those that a file declares, then at what is really there, since a declared size may be false. A file
beyond a bound is refused in one line that names the file, the bound and the remedy, with the exit code of a
file that cannot be used (2; 5 for a log). This takes at most 500 MB of memory and 5 s.

Where a limit grows with the file, the larger of both holds. So a flight log or bag of any size can be read.

| files | what | limit | why |
|---|---|---|---|
"""


def page() -> str:
    """Return the page as Markdown: one line for each bound."""
    rows = [f"| {bound.files} | {bound.what} | {_limit(bound)} | {bound.why} |" for bound in BOUNDS]
    return _HEAD + "\n".join(rows) + "\n"


def _limit(bound: Bound) -> str:
    if bound.unit == "bytes":
        unit, amount = ("MiB", bound.limit / MIB) if bound.limit >= MIB else ("KiB", bound.limit / 1024)
        text = f"{amount:g} {unit}"
    else:
        text = f"{bound.limit} {bound.unit}"
    if bound.per_byte:
        many = f"{bound.per_byte:g} times" if bound.unit == "bytes" else f"{bound.per_byte:g} a byte of"
        text += f", or {many} the file"
    return text


if __name__ == "__main__":
    Path(sys.argv[1]).write_text(page(), encoding="utf-8")
