"""Parameter values on board: float32, bounded, and what the law gets of them."""

import pytest

from trimtab.firmware_model.flight.parameters import ParameterValues, index_of, name_at
from trimtab.firmware_model.law import step as law
from trimtab.protocol.parameters import DEFAULTS, PARAMETERS, float32


def test_values_start_at_the_table_with_what_is_given():
    values = ParameterValues({"MASS": 0.8})
    assert list(values) == [p.name for p in PARAMETERS]
    assert values["MASS"] == float32(0.8)
    assert values["HOVER_S"] == DEFAULTS["HOVER_S"]
    assert values.us("HOVER_S") == 1_000_000


def test_law_reads_only_names_of_the_table():
    assert set(law.SOURCES) <= set(DEFAULTS)
    direct = [name for name in law.PARAMETERS if not name.startswith("ALLOCATION_")]
    assert set(direct) <= set(DEFAULTS)


def test_set_changes_value_and_vector():
    values = ParameterValues({})
    assert values.set("POS_P_E", 7.1) == float32(7.1)
    assert values.vector[law.PARAMETERS.index("POS_P_E")] == float32(7.1)


def test_set_refused_changes_nothing():
    values = ParameterValues({})
    for k in (1, 2, 3):
        values.set(f"ROTOR{k}_X", 0.0)
    before, vector = dict(values), list(values.vector)
    with pytest.raises(ValueError, match="POS_P_E: 1e\\+06"):
        values.set("POS_P_E", 1e6)
    with pytest.raises(KeyError):
        values.set("NO_SUCH", 1.0)
    with pytest.raises(ValueError, match="ROTOR4_X: singular"):
        values.set("ROTOR4_X", 0.0)  # all rotors in a line
    assert (dict(values), list(values.vector)) == (before, vector)


@pytest.mark.parametrize(
    ("name", "value"),
    [("FENCE_N_MIN", 20.0), ("FENCE_D_MAX", -6.0), ("LIM_THR_LO", 0.65), ("LIM_THR_HI", 0.0)],
)
def test_limits_that_contradict_each_other_are_refused(name, value):
    with pytest.raises(ValueError, match="is not an interval"):
        ParameterValues({name: value})
    values = ParameterValues({})
    before, limits = dict(values), values.limits
    with pytest.raises(ValueError, match=f"{name}: .*is not an interval"):
        values.set(name, value)
    assert (dict(values), values.limits) == (before, limits)


def test_set_changes_what_references_are_checked_by():
    values = ParameterValues({})
    values.set("LIM_SPEED", 2.5)
    values.set("MASS", 0.8)
    assert values.limits.speed_max_m_s == 2.5
    assert values.airframe.mass_kg == float32(0.8)


def test_places_in_the_table_go_both_ways():
    names = [name for k in range(len(PARAMETERS)) if (name := name_at(k)) is not None]
    assert [index_of(name) for name in names] == list(range(len(PARAMETERS)))
    assert name_at(len(PARAMETERS)) is None
    assert name_at(-1) is None
    assert index_of("NO_SUCH") is None
