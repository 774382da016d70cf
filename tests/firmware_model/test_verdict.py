"""The on-board verdict: by the vehicle's own numbers, with a reason, without exceptions."""

import random

import pytest

from firmware_model.parameters import ParameterValues
from firmware_model.verdict import Reason, check_blob
from protocol.blobs import FeedForward, Kind, Reference

VEHICLE_ID = "0123456789ab"
BLOCK = (1.0, *(0.0,) * 12)


def verdict(kind, data, **parameters):
    return check_blob(kind, data, parameters=ParameterValues(parameters), vehicle_id=VEHICLE_ID)


def feedforward(**changes):
    block = list(BLOCK)
    for place, value in changes.items():
        block[int(place[1:])] = value
    return FeedForward(vehicle_id=VEHICLE_ID, model_id="00112233aabb", block=tuple(block)).to_bytes()


def test_reference_within_limits_is_accepted(make_blob):
    assert verdict(Kind.REFERENCE, make_blob().to_bytes()).ok


@pytest.mark.parametrize(
    ("limit", "value", "reason"),
    [("LIM_SPEED", 1.0, 7), ("LIM_TILT_DEG", 5.0, 8), ("LIM_JERK", 1.0, 10), ("FENCE_N_MAX", 1.0, 6)],
)
def test_reference_is_judged_by_the_parameters_on_board(make_blob, limit, value, reason):
    found = verdict(Kind.REFERENCE, make_blob().to_bytes(), **{limit: value})
    assert not found.ok
    assert found.reason == reason
    assert found.node is not None
    assert found.bound == pytest.approx(value)


def test_reference_that_starts_too_low_is_refused(make_blob):
    assert verdict(Kind.REFERENCE, make_blob(height=0.3).to_bytes()).reason == 5


def test_blob_of_another_vehicle_or_kind_is_refused(make_blob):
    assert verdict(Kind.REFERENCE, make_blob(vehicle_id="ff" * 6).to_bytes()).reason == Reason.OTHER_VEHICLE
    assert verdict(Kind.FEEDFORWARD, make_blob().to_bytes()).reason == Reason.OTHER_KIND


@pytest.mark.parametrize(
    ("changes", "ok"),
    [
        ({}, True),
        ({"_0": 1.4}, True),
        ({"_0": 4.0}, False),
        ({"_1": -6.0}, False),
        ({"_5": 9.0}, False),
        ({"_10": 0.3}, False),
        ({"_12": 0.02}, True),
        ({"_12": 0.5}, False),
    ],
)
def test_feedforward_is_bounded(changes, ok):
    found = verdict(Kind.FEEDFORWARD, feedforward(**changes))
    assert found.ok is ok
    assert found.reason == (0 if ok else Reason.FEEDFORWARD_RANGE)


def test_damaged_blobs_never_raise(make_blob):
    data = make_blob().to_bytes()
    chance = random.Random(3)
    for _ in range(300):
        damaged = bytearray(data[: chance.randrange(len(data) + 1)])
        for _ in range(chance.randrange(3)):
            if damaged:
                damaged[chance.randrange(len(damaged))] = chance.randrange(256)
        found = verdict(Kind.REFERENCE, bytes(damaged))
        assert found.ok or found.message
    assert Reference.from_bytes(data).id == make_blob().id
