"""Wire encoding of parameters: the float field holds a float32, or the bits of an int32 for whole numbers."""

from __future__ import annotations

import struct

from trimtab.protocol.messages import mavlink
from trimtab.protocol.parameters import Parameter

INT32 = mavlink.MAV_PARAM_TYPE_INT32
REAL32 = mavlink.MAV_PARAM_TYPE_REAL32
_INT = struct.Struct("<i")
_FLOAT = struct.Struct("<f")


def type_of(row: Parameter | None) -> int:
    """Return the MAV_PARAM_TYPE of a row of the table; REAL32 for None."""
    return INT32 if row is not None and row.integer else REAL32


def encode(value: float, kind: int) -> float:
    """Return param_value for a value of this type. Raises ValueError if `value` does not fit an int32."""
    if kind != INT32:
        return value
    try:
        if value != int(value):
            raise ValueError
        return _FLOAT.unpack(_INT.pack(int(value)))[0]
    except (struct.error, OverflowError, ValueError):
        raise ValueError(f"{value:g} is not an int32") from None


def decode(raw: float, kind: int) -> float:
    """Return the value of a param_value of this type. Raises ValueError for any other type."""
    if kind == INT32:
        return float(_INT.unpack(_FLOAT.pack(raw))[0])
    if kind == REAL32:
        return raw
    raise ValueError(f"type {kind} is neither REAL32 ({REAL32}) nor INT32 ({INT32})")
