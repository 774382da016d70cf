"""Whole numbers as bits in the float field, both ways; everything else as it is."""

import math
import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from trimtab.protocol import messages as m
from trimtab.protocol.codec import Codec
from trimtab.protocol.parameter_wire import INT32, REAL32, decode, encode, type_of
from trimtab.protocol.parameters import BY_NAME


@given(st.integers(-(2**22), 2**24))
def test_whole_number_survives_the_wire(value):
    message = m.ParamValue(b"N", encode(float(value), INT32), INT32, 1, 0)
    (got,) = Codec(1, 1).decode(Codec(2, 1).encode(message))
    assert isinstance(got, m.ParamValue)
    assert decode(got.param_value, got.param_type) == value
    assert got._payload is not None
    assert struct.unpack("<i", got._payload[:4])[0] == value


def test_float_is_as_it_is():
    assert encode(0.5, REAL32) == decode(0.5, REAL32) == 0.5
    assert math.isnan(decode(math.nan, REAL32))


@pytest.mark.parametrize("value", [0.5, 1e10, math.nan, math.inf])
def test_what_is_no_whole_number_is_refused(value):
    with pytest.raises(ValueError, match="is not an int32"):
        encode(value, INT32)


def test_other_types_are_refused():
    with pytest.raises(ValueError, match="type 1 is neither"):
        decode(1.0, 1)


def test_type_is_that_of_the_table():
    assert type_of(BY_NAME["BAT_CELLS"]) == INT32
    assert type_of(BY_NAME["MASS"]) == type_of(None) == REAL32
