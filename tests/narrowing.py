"""Narrow types of optional values in tests."""

from __future__ import annotations

from typing import TypeVar

T = TypeVar("T")


def not_none(value: T | None) -> T:
    """Return the value. Raises AssertionError where it is None."""
    assert value is not None
    return value
