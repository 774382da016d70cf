"""Findings in the JSON, and the codes of refused logs."""

from __future__ import annotations

from dataclasses import FrozenInstanceError

import pytest

from trimtab.host.base.errors import UsageError
from trimtab.host.trace.decision.findings import (
    DOUBTS,
    OUTSIDE_LIBRARY_CODES,
    Code,
    Finding,
    LogsRefused,
    Verdict,
)


def test_finding_to_json_holds_every_field() -> None:
    finding = Finding(
        code=Code.RATE_DROPS,
        value=12.0,
        bound=50.0,
        unit="Hz",
        subject=("/mocap/pose",),
        log="one.mcap",
        details={"median_hz": 100.0},
    )
    assert finding.to_json() == {
        "code": "rate-drops",
        "value": 12.0,
        "bound": 50.0,
        "unit": "Hz",
        "subject": ["/mocap/pose"],
        "log": "one.mcap",
        "details": {"median_hz": 100.0},
    }


def test_finding_to_json_without_a_comparison_holds_nulls() -> None:
    assert Finding(code=Code.NO_GYRO).to_json() == {
        "code": "no-gyro",
        "value": None,
        "bound": None,
        "unit": "1",
        "subject": [],
        "log": None,
        "details": {},
    }


def test_finding_cannot_be_changed() -> None:
    finding = Finding(code=Code.NO_GYRO)
    with pytest.raises(FrozenInstanceError):
        finding.value = 1.0  # pyright: ignore[reportAttributeAccessIssue]  # frozen


def test_logs_refused_holds_its_code_and_its_message() -> None:
    error = LogsRefused(Code.NO_TRACKING, "no tracking phase")
    assert isinstance(error, UsageError)
    assert str(error) == "no tracking phase"
    assert error.details == {"code": "no-tracking"}


def test_codes_are_their_names_as_the_json_documents_them() -> None:
    assert [str(each) for each in Verdict] == ["traced", "nothing-missing", "undecided", "outside-library"]
    # The JSON keeps the older code "no-twin" for a flight without a repeat flight.
    assert str(Code.NO_REPEAT) == "no-twin"
    named = set(Code) - {Code.NO_REPEAT}
    assert {code.name.lower().replace("_", "-") for code in named} == {str(code) for code in named}


def test_reasons_and_doubts_are_the_documented_codes() -> None:
    assert {str(code) for code in OUTSIDE_LIBRARY_CODES} == {
        "flights-repeat",
        "flights-worsened",
        "force-repeats",
        "torque-repeats",
        "force-rings",
        "torque-rings",
        "force-pulses",
    }
    assert {str(code) for code in DOUBTS} == {
        "tracking-too-short",
        "hover-only",
        "poses-too-slow",
        "excess-force",
        "excess-torque",
        "better-but-inadmissible",
        "segments-disagree",
        "only-hover",
        "time-ran-late",
    }
