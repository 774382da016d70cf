"""Tables of bounded size that forget what was used least recently."""

from __future__ import annotations

from typing import TypeVar

Key = TypeVar("Key")
Value = TypeVar("Value")


def remember(table: dict[Key, Value], key: Key, value: Value, most: int) -> None:
    """Set an entry; beyond `most` entries forget the one that was set least recently."""
    table.pop(key, None)
    table[key] = value
    if len(table) > most:
        del table[next(iter(table))]
