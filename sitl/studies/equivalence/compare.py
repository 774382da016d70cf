"""Compare the records of two commits, value by value."""

from __future__ import annotations

import json
import math
import re
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import Any

IGNORED_KEYS = frozenset(
    {
        *("seconds", "solve_s", "trace_s", "wall_s", "cpu_s", "realtime_factor"),
        *("git", "version", "program_id", "command", "sources", "log_id", "data"),
    }
)
"""Keys that differ between two runs of the same code, name the program, or hash a file that names it."""

IGNORED_PATH = re.compile(r"\.model\.toml\.id$")
"""Ids of traced models, which depend on the hashes of the effects' source files."""

RELATIVE = 1e-12
PARAMETER_SD = 0.01
REFERENCE_M = 1e-4


class Kind(StrEnum):
    """How two values differ."""

    MISSING = "missing"
    VALUE = "value"
    NUMBER = "number"
    WORDS = "words"


@dataclass(frozen=True, kw_only=True)
class Difference:
    """One value that differs: its record, its path in the record, and both values."""

    record: str
    path: str
    kind: Kind
    before: Any
    after: Any

    def __str__(self) -> str:
        return f"{self.record} {self.path}: {self.kind}: {_short(self.before)} -> {_short(self.after)}"


def compare(before: Path, after: Path, *, regrouped: bool) -> tuple[Counter[str], list[Difference]]:
    """Return the number of records of each part, and every difference.

    With `regrouped`, arithmetic may be regrouped: parameters may differ by 0.01 sd, references by 0.1 mm, and
    other numbers by 1 %. Flights must be equal to the bit in either case.
    """
    counts: Counter[str] = Counter()
    differences: list[Difference] = []
    for path in sorted(before.glob("*/*.json")):
        if path.parent.name == "inputs":
            continue
        record = f"{path.parent.name}/{path.stem}"
        other = after / path.parent.name / path.name
        counts[path.parent.name] += 1
        if not other.is_file():
            differences.append(
                Difference(record=record, path="", kind=Kind.MISSING, before="record", after=None)
            )
            continue
        old, new = (json.loads(p.read_text(encoding="utf-8")) for p in (path, other))
        differences += [d for d in _walk(record, "", old, new) if not (regrouped and _is_close(d, old))]
    return counts, differences


def _walk(record: str, path: str, old: Any, new: Any) -> Iterator[Difference]:
    """Yield the differences below `path`. Keys that only `new` has are allowed."""
    if isinstance(old, dict) and isinstance(new, dict):
        for key, value in old.items():
            where = f"{path}.{key}" if path else key
            if key in IGNORED_KEYS or IGNORED_PATH.search(where):
                continue
            if key not in new:
                yield Difference(record=record, path=where, kind=Kind.MISSING, before=value, after=None)
            else:
                yield from _walk(record, where, value, new[key])
    elif isinstance(old, list) and isinstance(new, list) and len(old) == len(new):
        for index, pair in enumerate(zip(old, new, strict=True)):
            yield from _walk(record, f"{path}[{index}]", *pair)
    elif old != new:
        yield Difference(record=record, path=path, kind=_kind(old, new), before=old, after=new)


def _kind(old: Any, new: Any) -> Kind:
    if _is_number(old) and _is_number(new):
        return Kind.NUMBER
    texts = [t for value in (old, new) for t in (value if isinstance(value, list) else [value])]
    if texts and all(isinstance(t, str) for t in texts) and any(" " in t for t in texts):
        return Kind.WORDS
    return Kind.VALUE


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _is_close(difference: Difference, record: Any) -> bool:
    """Return whether regrouped arithmetic explains the difference."""
    if difference.path.endswith("id") and difference.kind is Kind.VALUE:
        return True  # a content id changes with the last bit of any number in the content
    if difference.kind is not Kind.NUMBER:
        return False
    gap = abs(difference.before - difference.after)
    if difference.path.endswith(".value"):
        sd = _at(record, difference.path.removesuffix("value") + "sd")
        return _is_number(sd) and gap <= PARAMETER_SD * sd
    if ".nodes[" in difference.path:
        return gap <= REFERENCE_M
    return math.isclose(difference.before, difference.after, rel_tol=1e-2, abs_tol=RELATIVE)


def _at(record: Any, path: str) -> Any:
    """Return the value at a dotted path with [index] parts, or None."""
    for part in path.replace("[", ".[").split("."):
        if part.startswith("["):
            record = record[int(part[1:-1])]
        elif isinstance(record, dict):
            record = record.get(part)
        else:
            return None
    return record


def _short(value: Any) -> str:
    text = json.dumps(value)
    return text if len(text) <= 120 else text[:117] + "..."
