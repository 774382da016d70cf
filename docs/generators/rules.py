"""Generate docs/reference/tracing-rules.md, on the thresholds of tracing, from the rules themselves.

`python docs/generators/rules.py FILE` writes it. A test compares the page with the code.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path

from trimtab.host.trace.decision.rules import RuleRow, table

_HEAD = """# The rules of tracing

<!-- Made by `make docs` from host/trace/decision/rules.py; change it there. -->

`trimtab trace` decides by the thresholds in this table. Every comparison that decided something is a finding
in the answer (`findings` with `--json`): its code, the value and the bound. Thresholds that belong to one
effect, such as its tolerance, are on the page on [effects](effects.md).

The last column gives the source of a value. *Chosen*: a definition or a judgement, without a measurement
behind it. *Measured*: measured in simulated worlds without effects; `trimtab study calibrate` repeats the
measurement. [Studies](../studies/studies.md#calibrate) has the latest one.

| rule | value | unit | meaning | source |
|---|---|---|---|---|
"""


def page(rows: Sequence[RuleRow]) -> str:
    """Return the page as Markdown: one line for each rule."""

    def shown(value: float | tuple[float, ...]) -> str:
        return ", ".join(f"{each:.4g}" for each in (value if isinstance(value, tuple) else (value,)))

    lines = [
        f"| `{row.name}` | {shown(row.value)} | {row.unit} | {row.meaning} | {row.source} |" for row in rows
    ]
    return _HEAD + "\n".join(lines) + "\n"


if __name__ == "__main__":
    Path(sys.argv[1]).write_text(page(table()), encoding="utf-8")
