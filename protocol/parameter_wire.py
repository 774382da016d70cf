"""Parameters on the wire: whole numbers as the bits of an int32 in the float field, others as they are."""

from __future__ import annotations

import struct

from trimtab.protocol.messages import mavlink
from trimtab.protocol.parameters import Parameter

INT32 = mavlink.MAV_PARAM_TYPE_INT32
REAL32 = mavlink.MAV_PARAM_TYPE_REAL32
_INT = struct.Struct("<i")
_FLOAT = struct.Struct("<f")


def type_of(row: Parameter | None) -> int:
    """MAV_PARAM_TYPE by which a row of the table travels; that of floats for one that is not in it."""
    return INT32 if row is not None and row.integer else REAL32


def encode(value: float, kind: int) -> float:
    """Return what goes into param_value. Raises ValueError where an int32 is asked for and `value` is
    none.
    """
    if kind != INT32:
        return value
    try:
        if value != int(value):
            raise ValueError
        return _FLOAT.unpack(_INT.pack(int(value)))[0]
    except (struct.error, OverflowError, ValueError):
        raise ValueError(f"{value:g} is no int32") from None


def decode(raw: float, kind: int) -> float:
    """Return the value that a param_value of this type stands for. Raises ValueError for any other type."""
    if kind == INT32:
        return float(_INT.unpack(_FLOAT.pack(raw))[0])
    if kind == REAL32:
        return raw
    raise ValueError(f"type {kind} is neither REAL32 ({REAL32}) nor INT32 ({INT32})")
