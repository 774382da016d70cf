"""The on-board verdict: by the vehicle's own numbers, with a reason, without exceptions."""

import math
import random
from dataclasses import replace

import pytest

from trimtab.firmware_model.flight.parameters import ParameterValues
from trimtab.firmware_model.flight.verdict import Reason, check_blob
from trimtab.protocol.blobs import NEUTRAL_BLOCK, FeedForward, Kind, Node, Reference, TrainedRegion

VEHICLE_ID = "0123456789ab"


def verdict(kind, data, battery_v=0.0, **parameters):
    values = ParameterValues(parameters)
    return check_blob(kind, data, parameters=values, vehicle_id=VEHICLE_ID, battery_v=battery_v)


def feedforward(**changes):
    block = list(NEUTRAL_BLOCK)
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


def test_reference_with_one_acceleration_off_is_refused_with_its_node(make_blob):
    blob = make_blob(pieces=20)
    node = blob.nodes[13]
    state = (*node.state[:6], node.state[6] + 0.5, *node.state[7:])
    nodes = (*blob.nodes[:13], Node(node.t_us, state), *blob.nodes[14:])
    found = verdict(Kind.REFERENCE, replace(blob, nodes=nodes).to_bytes())
    assert (found.ok, found.node, found.reason) == (False, 13, 13)
    assert (found.value, found.bound) == (pytest.approx(0.5, abs=0.01), 0.25)


def test_reference_that_asks_for_more_thrust_than_the_battery_gives_is_refused(make_blob):
    blob = make_blob(reach=3.0, seconds=1.5, pieces=15).to_bytes()
    assert verdict(Kind.REFERENCE, blob).ok
    assert verdict(Kind.REFERENCE, blob, battery_v=16.8).ok
    # 3 m in 1.5 s and back asks a rotor for 0.326 of its greatest thrust.
    needed = verdict(Kind.REFERENCE, blob, LIM_THR_HI=0.3)
    assert (needed.reason, needed.bound) == (12, pytest.approx(0.3))
    low = 16.8 * math.sqrt(0.3 / 0.95)
    found = verdict(Kind.REFERENCE, blob, battery_v=low, BAT_EMPTY_V=5.0)
    assert (found.reason, found.node) == (14, needed.node)
    assert (found.value, found.bound) == (pytest.approx(needed.value), pytest.approx(0.3))
    assert found.message.endswith("of max, the battery gives 0.3")


def test_any_reference_is_refused_at_an_almost_empty_battery(make_blob):
    blob = make_blob().to_bytes()
    assert verdict(Kind.REFERENCE, blob, battery_v=13.61).ok
    found = verdict(Kind.REFERENCE, blob, battery_v=13.59)
    assert (found.reason, found.node, found.value) == (14, None, pytest.approx(13.59))
    assert found.message == "battery at 13.59 V, below 13.60 V"
    assert verdict(Kind.FEEDFORWARD, feedforward(), battery_v=13.0).ok


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
        ({"_14": -14.0}, True),
        ({"_15": 16.0}, False),
        ({"_16": 2.0}, True),
        ({"_16": -6.0}, False),
    ],
)
def test_feedforward_is_bounded(changes, ok):
    found = verdict(Kind.FEEDFORWARD, feedforward(**changes))
    assert found.ok is ok
    assert found.reason == (0 if ok else Reason.FEEDFORWARD_RANGE)


@pytest.mark.parametrize("frame", ["world", "body"])
def test_network_is_bounded_within_its_region(frame):
    # out = (slope v_x, 0, 0) in a hidden unit that is almost linear, bounded by tanh at 10 m/s^2.
    inputs = 6 if frame == "world" else 3

    def network(slope, region):
        weights = (0.1 * slope, *(0.0,) * inputs, 10.0, 0.0, 0.0, 0.0, 0.0, 0.0)
        blob = FeedForward(
            vehicle_id=VEHICLE_ID,
            model_id="00112233aabb",
            layers=(1,),
            weights=weights,
            frame=frame,
            region=region,
        )
        return verdict(Kind.FEEDFORWARD, blob.to_bytes())

    slow = TrainedRegion(2.0, 0.3, 5.0, 15.0)
    assert network(-1.0, slow).ok
    found = network(-1.0, slow._replace(speed_max_m_s=8.0))
    assert (found.ok, found.reason, found.bound) == (False, Reason.FEEDFORWARD_RANGE, 5.0)
    assert found.value == pytest.approx(10.0 * math.tanh(0.8), rel=1e-6)
    assert not network(-1.0, None).ok


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
