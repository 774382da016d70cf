"""Canonical TOML text of a strict model: the same model gives the same bytes."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from trimtab.host.vehicle.strict_toml import Strict


def write_toml(model: Strict) -> str:
    """Return the canonical TOML of a strict model: fields in declared order, scalars first, no `None`."""
    lines: list[str] = []
    _write_table(model, "", lines)
    return "\n".join(lines) + "\n"


def _write_table(table: Strict | Mapping[str, Any], prefix: str, lines: list[str]) -> None:
    """Append a table's own keys, then its sub-tables under their full names."""
    if isinstance(table, Strict):
        items = [(name, getattr(table, name)) for name in type(table).model_fields]
    else:
        items = sorted(table.items())
    nested = []
    for key, value in items:
        if value is None:
            continue
        if _is_table(value) or (isinstance(value, tuple) and value and _is_table(value[0])):
            nested.append((key, value))
        else:
            lines.append(f"{_key(key)} = {_value(value)}")
    for key, value in nested:
        name = f"{prefix}{_key(key)}"
        for entry in value if isinstance(value, tuple) else (value,):
            lines.extend(("", f"[[{name}]]" if isinstance(value, tuple) else f"[{name}]"))
            _write_table(entry, f"{name}.", lines)


def _is_table(value: Any) -> bool:
    return isinstance(value, Strict | Mapping)


def _key(key: str) -> str:
    """Return a bare key if TOML allows it, else a quoted one."""
    return key if key.replace("_", "").replace("-", "").isalnum() and key.isascii() else f'"{key}"'


def _value(value: Any) -> str:
    """Return a scalar or a list of scalars as TOML."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, int | float):
        return repr(value)
    if isinstance(value, str):
        escaped = value.replace("\\", "\\\\").replace('"', '\\"')
        return '"' + "".join(c if c >= " " and c != "\x7f" else f"\\u{ord(c):04x}" for c in escaped) + '"'
    return "[" + ", ".join(_value(item) for item in value) + "]"
