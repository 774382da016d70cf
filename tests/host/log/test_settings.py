"""Settings on board that differ between two sets of flights."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from trimtab.host.log import (
    ChangedSetting,
    Flight,
    changed_between,
    read_flight,
    settings_lines,
    settings_of,
)
from trimtab.host.log.settings import FEEDFORWARD, HOST_CONTROLLER, NONE

DATA = Path(__file__).parents[2] / "data"
SIDES = ("before", "after")


def flight() -> Flight:
    return read_flight(DATA / "a1.mcap")


def retuned(**parameters: float) -> Flight:
    """Return the flight with other parameters on board."""
    one = flight()
    return replace(one, firmware_parameters={**(one.firmware_parameters or {}), **parameters})


def test_a_changed_gain_is_listed_with_all_values_of_each_set() -> None:
    found = changed_between(
        [flight(), retuned(RATE_P_X=25.0)], [retuned(RATE_P_X=25.0), retuned(RATE_P_X=20.0)]
    )
    assert found == (ChangedSetting(name="RATE_P_X", before=(25.0, 30.0), after=(20.0, 25.0)),)
    assert settings_lines(found, SIDES) == [
        "settings on board that differ: RATE_P_X 25 and 30 before, 20 and 25 after"
    ]


def test_the_same_settings_are_said_to_be_the_same() -> None:
    found = changed_between([flight()], [flight(), flight()])
    assert found == ()
    assert settings_lines(found, SIDES) == ["settings on board: the same"]


def test_a_parameter_that_one_firmware_lacks_is_listed() -> None:
    found = changed_between([flight()], [retuned(NEW_GAIN=2.0)])
    assert found == (ChangedSetting(name="NEW_GAIN", before=(), after=(2.0,)),)
    assert settings_lines(found, SIDES)[0].endswith("NEW_GAIN not there before, 2 after")


def test_feed_forward_and_controller_on_the_host_are_settings() -> None:
    one = flight()
    corrected = replace(one, metadata={**one.metadata, "feedforward_id": "0123456789ab"})
    assert changed_between([one], [corrected]) == (
        ChangedSetting(name=FEEDFORWARD, before=(NONE,), after=("0123456789ab",)),
    )
    settings = settings_of(one)
    assert settings is not None
    assert settings[HOST_CONTROLLER] == NONE


def test_logs_without_parameters_say_nothing() -> None:
    imported = replace(flight(), firmware_parameters=None)
    assert settings_of(imported) is None
    found = changed_between([imported], [flight()])
    assert found is None
    assert settings_lines(found, SIDES) == []
    assert changed_between([imported, flight()], [flight()]) == ()


def test_a_long_list_is_cut() -> None:
    found = changed_between([flight()], [retuned(**{f"NEW_{i}": 1.0 for i in range(10)})])
    (line,) = settings_lines(found, SIDES)
    assert line.endswith("NEW_7 not there before, 1 after; and 2 more")
