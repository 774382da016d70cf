"""The parameter table."""

from __future__ import annotations

import math

import pytest

from trimtab.protocol import parameters
from trimtab.protocol.parameters import BY_NAME, DEFAULTS, INDEX, PARAMETERS, Parameter


def test_every_row_has_a_short_name_a_description_and_a_default_that_survives_float32() -> None:
    for row in PARAMETERS:
        assert len(row.name) <= 16
        assert row.name == row.name.upper()
        assert row.description
        assert row.check(row.default) == parameters.float32(row.default)
        assert row.check(row.min) == parameters.float32(row.min)
        assert row.check(row.max) == parameters.float32(row.max)


def test_lookups_agree_with_the_table() -> None:
    assert list(BY_NAME) == list(DEFAULTS) == list(INDEX) == [row.name for row in PARAMETERS]
    assert [INDEX[row.name] for row in PARAMETERS] == list(range(len(PARAMETERS)))


def test_defaults_let_the_research_quad_hover() -> None:
    assert 4 * DEFAULTS["THRUST_MAX"] * DEFAULTS["LIM_THR_HI"] > DEFAULTS["MASS"] * 9.81
    assert DEFAULTS["THRUST_C1"] + DEFAULTS["THRUST_C2"] == 1.0
    assert sum(DEFAULTS[f"ROTOR{k}_SPIN"] for k in (1, 2, 3, 4)) == 0.0


def test_the_law_reads_only_names_of_the_table() -> None:
    from trimtab.firmware_model.law import step

    assert set(step.SOURCES) <= set(BY_NAME)


def test_values_are_compared_as_float32() -> None:
    assert parameters.equal(0.1, parameters.float32(0.1))
    assert not parameters.equal(0.1, 0.1000001)
    assert parameters.differences(
        {"MASS": 0.1, "HOLD_S": 1.0}, {"MASS": parameters.float32(0.1), "HOLD_S": 2.0}
    ) == {"HOLD_S": (1.0, 2.0)}


def test_a_parameter_missing_on_board_is_a_difference() -> None:
    ((expected, other),) = parameters.differences({"MASS": 1.0}, {}).values()
    assert expected == 1.0
    assert math.isnan(other)


def test_place_of_the_origin_is_no_difference_of_the_vehicle() -> None:
    elsewhere = {**DEFAULTS, "ORIGIN_LAT_DEG": -33.0, "ORIGIN_LON_E7": 1.0, "ORIGIN_ALT": 12.0}
    assert set(elsewhere) >= parameters.ORIGIN
    assert parameters.differences(DEFAULTS, elsewhere) == {}


def test_complete_fills_defaults_in_the_table_order() -> None:
    values = parameters.complete({"HOLD_S": 2.5})
    assert list(values) == [row.name for row in PARAMETERS]
    assert values["HOLD_S"] == 2.5
    assert values["MASS"] == parameters.float32(0.752)


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"HOLD": 1.0}, "no such parameter: HOLD"),
        ({"MASS": -1.0}, "MASS: -1 is outside 0.01..50 kg"),
        ({"MASS": math.nan}, "MASS: nan is not a finite number"),
        ({"MASS": 1e300}, "MASS: 1e[+]300 is beyond float32"),
    ],
)
def test_complete_with_a_bad_entry_names_it(values: dict, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        parameters.complete(values)


@pytest.mark.parametrize("name", ["", "SEVENTEEN_LETTERS", "MÄSS"])
def test_a_row_with_a_name_that_does_not_travel_is_refused(name: str) -> None:
    with pytest.raises(ValueError, match="1 to 16 ASCII"):
        Parameter(name=name, default=0.0, unit="", min=0.0, max=1.0, description="x")
