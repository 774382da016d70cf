"""The page on the thresholds of tracing, docs/reference/tracing-rules.md, made from the rules themselves.

`python docs/generators/rules.py FILE` writes it; a test holds the page against the code.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path

from trimtab.host.trace.decision.rules import RuleRow, table

_HEAD = """# The rules of tracing

<!-- Made by `make docs` from host/trace/decision/rules.py; change it there. -->

`trimtab trace` decides by the thresholds in this table. A comparison that decided something is a finding in
the answer (`findings` with `--json`): its code, the value, and the bound it was held against. What belongs to
one effect, such as its tolerance, stands on the [effect](effects.md).

Source says where a value comes from. *Chosen*: a definition or a judgement, without a measurement behind it.
*Measured*: measured in simulated worlds that hold no effect; `trimtab study calibrate` repeats the
measurement. [Studies](../studies/studies.md#calibrate) has the last one.

| rule | value | unit | meaning | source |
|---|---|---|---|---|
"""


def page(rows: Sequence[RuleRow]) -> str:
    """Return the page as Markdown: one line for each rule."""
    lines = [
        f"| `{row.name}` | {row.value:.4g} | {row.unit} | {row.meaning} | {row.source} |" for row in rows
    ]
    return _HEAD + "\n".join(lines) + "\n"


if __name__ == "__main__":
    Path(sys.argv[1]).write_text(page(table()), encoding="utf-8")
