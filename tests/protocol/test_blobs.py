"""Blobs: bytes both ways, every field corrupted, arbitrary bytes."""

from __future__ import annotations

import contextlib
import hashlib
import math
import struct

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from trimtab.protocol import blobs
from trimtab.protocol.blobs import (
    NEUTRAL_BLOCK,
    BlobError,
    FeedForward,
    Kind,
    Node,
    Reference,
    TrainedRegion,
    YawNode,
)

VEHICLE = "0123456789ab"
GOLDEN = (
    "54525442 01 01 0000 0123456789ab 000000000000f03f 0000000000000040 00000000000008c0 02000000 01000000"
    "00000000 0000003f 00000000 000000bf"
    + "00000000" * 9
    + "a0860100"
    + "0000803f" * 12
    + "00000000 0000803f 00000000"
)
"""Two nodes 0.1 s apart, origin (1, 2, -3), yaw 1 throughout; by hand from the format's description."""


def make_reference(**changes) -> Reference:
    fields = {
        "vehicle_id": VEHICLE,
        "origin_ned": (1.0, 2.0, -3.0),
        "nodes": (Node(0, (0.5, 0.0, -0.5, *[0.0] * 9)), Node(100_000, (1.0,) * 12)),
        "yaws": (YawNode(0, 1.0, 0.0),),
    }
    return Reference(**{**fields, **changes})


def make_feedforward(**changes) -> FeedForward:
    layers = (4, 3)
    count = 7 * 4 + 5 * 3 + 4 * 3
    fields = {
        "vehicle_id": VEHICLE,
        "model_id": "ba9876543210",
        "block": NEUTRAL_BLOCK,
        "layers": layers,
        "weights": [0.25 * k for k in range(count)],
    }
    return FeedForward(**{**fields, **changes})


def test_reference_golden_bytes_both_ways() -> None:
    data = bytes.fromhex(GOLDEN)
    assert make_reference().to_bytes() == data
    assert Reference.from_bytes(data) == make_reference()
    assert blobs.from_bytes(data) == make_reference()
    assert make_reference().id == hashlib.sha256(data).hexdigest()[:12]
    assert len(data) == 46 + 2 * 52 + 12


@pytest.mark.parametrize(
    ("at", "bytes_", "field"),
    [
        (0, b"X", "magic"),
        (4, b"\x02", "kind"),
        (4, b"\x09", "kind"),
        (5, b"\x02", "version"),
        (6, b"\x02", "flags"),
        (14, struct.pack("<d", math.inf), "origin_ned"),
        (38, b"\x03", "length"),
        (42, b"\x00", "length"),
        (46, b"\x01", r"nodes\[0\].t_us"),
        (50, struct.pack("<f", math.nan), r"nodes\[0\].p_n"),
        (50 + 44, struct.pack("<f", -math.inf), r"nodes\[0\].j_d"),
        (98, bytes(4), r"nodes\[1\].t_us"),
        (154, struct.pack("<f", math.nan), r"yaws\[0\].yaw"),
    ],
)
def test_reference_with_one_field_corrupted_names_it(at: int, bytes_: bytes, field: str) -> None:
    data = bytearray.fromhex(GOLDEN)
    data[at : at + len(bytes_)] = bytes_
    with pytest.raises(BlobError, match=f"^{field}"):
        Reference.from_bytes(bytes(data))


def test_reference_cut_anywhere_or_with_bytes_behind_is_refused() -> None:
    data = bytes.fromhex(GOLDEN)
    for end in range(len(data)):
        with pytest.raises(BlobError, match=r"magic|kind|length"):
            Reference.from_bytes(data[:end])
    with pytest.raises(BlobError, match="length"):
        Reference.from_bytes(data + b"\0")


@pytest.mark.parametrize(
    ("changes", "field"),
    [
        ({"vehicle_id": "0123"}, "vehicle_id"),
        ({"vehicle_id": "0123456789AB"}, "vehicle_id"),
        ({"origin_ned": (0.0, math.nan, 0.0)}, r"origin_ned\[1\]"),
        ({"origin_ned": (0.0, 0.0)}, "origin_ned"),
        ({"nodes": (Node(0, (0.0,) * 12),)}, "nodes: .* at least 2"),
        ({"nodes": (Node(0, (0.0,) * 12), Node(5, (0.0,) * 11))}, r"nodes\[1\]"),
        ({"nodes": (Node(0, (0.0,) * 12), Node(2**32, (0.0,) * 12))}, r"nodes\[1\].t_us"),
        ({"nodes": (Node(0, (0.0,) * 12), Node(5, (*[0.0] * 5, 1e39, *[0.0] * 6)))}, r"nodes\[1\].v_d"),
        ({"yaws": (YawNode(5, 0.0, 0.0), YawNode(5, 0.0, 0.0))}, r"yaws\[1\].t_us"),
    ],
)
def test_reference_built_from_bad_values_names_the_field(changes: dict, field: str) -> None:
    with pytest.raises(BlobError, match=f"^{field}"):
        make_reference(**changes)


def test_reference_rounds_to_float32_when_built() -> None:
    reference = make_reference(nodes=(Node(0, (0.1,) * 12), Node(9, (0.2,) * 12)))
    assert reference.nodes[0].state[0] == struct.unpack("<f", struct.pack("<f", 0.1))[0] != 0.1
    assert Reference.from_bytes(reference.to_bytes()) == reference


def test_reference_nodes_ned_add_the_origin_in_double() -> None:
    reference = make_reference(origin_ned=(1e7 + 0.1, 0.0, -0.3))
    assert reference.nodes_ned()[0].state[:3] == (1e7 + 0.6, 0.0, -0.8)
    assert reference.nodes_ned()[1].state[3:] == (1.0,) * 9


def test_reference_without_yaw_rows_has_yaw_zero() -> None:
    assert make_reference(yaws=()).yaw_nodes() == (YawNode(0, 0.0, 0.0),)
    assert len(make_reference(yaws=()).to_bytes()) == 46 + 2 * 52


def test_reference_free_ends_travel_in_the_flags() -> None:
    data = make_reference(free_ends=True).to_bytes()
    assert data[6:8] == b"\x01\x00"
    assert Reference.from_bytes(data).free_ends


REGION = TrainedRegion(4.0, 0.5, 7.0, 13.0)
BODY = {"frame": "body", "weights": [0.25] * (4 * 4 + 5 * 3 + 4 * 3)}


@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"block": None},
        {"layers": (), "weights": ()},
        {"layers": (32, 32, 32), "weights": [0.1] * 2435},
        {"region": REGION},
        BODY,
        {"block": None, "region": REGION, **BODY},
        {"version": 1},
        {"block": (*NEUTRAL_BLOCK[:13], 1.0, -2.0, 0.5, 2.0)},
    ],
)
def test_feedforward_of_each_form_survives_both_ways(changes: dict) -> None:
    feedforward = make_feedforward(**changes)
    assert FeedForward.from_bytes(feedforward.to_bytes()) == feedforward
    assert blobs.from_bytes(feedforward.to_bytes()) == feedforward
    assert blobs.kind_of(feedforward.to_bytes()) is Kind.FEEDFORWARD


def test_feedforward_golden_bytes_of_a_block_of_version_1() -> None:
    header = "54525442 02 01 0100 0123456789ab" + "00" * 24 + "0d000000 00000000" + "ba9876543210 00"
    data = bytes.fromhex(header + "0000803f" + "00000000" * 12)
    assert make_feedforward(layers=(), weights=(), version=1).to_bytes() == data
    assert FeedForward.from_bytes(data).block == NEUTRAL_BLOCK


def test_feedforward_golden_bytes_of_version_2() -> None:
    header = "54525442 02 02 0f00 0123456789ab" + "00" * 24 + "11000000 0a000000" + "ba9876543210 01 01"
    block = "0000803f" + "00000000" * 12 + "0000803f" + "00000000" * 2 + "00000040"
    region = "00008040" + "0000003f" + "0000e040" + "00005041"
    data = bytes.fromhex(header + block + "0000803e" * 10 + region)
    feedforward = make_feedforward(
        block=(*NEUTRAL_BLOCK[:13], 1.0, 0.0, 0.0, 2.0),
        layers=(1,),
        weights=[0.25] * 10,
        frame="body",
        region=REGION,
    )
    assert feedforward.to_bytes() == data
    assert FeedForward.from_bytes(data) == feedforward


@pytest.mark.parametrize(
    ("changes", "field"),
    [
        ({"model_id": "x" * 12}, "model_id"),
        ({"block": None, "layers": (), "weights": ()}, "block: .* or both"),
        ({"block": (0.0, *NEUTRAL_BLOCK[1:])}, "block.gain"),
        ({"block": (*NEUTRAL_BLOCK[:12], -0.1, *NEUTRAL_BLOCK[13:])}, "block.prediction_time_s"),
        ({"block": NEUTRAL_BLOCK[:-1]}, "block: has 16"),
        ({"version": 3}, "version: 3"),
        ({"version": 1, "region": REGION}, "version: 1 has no body frame and no region"),
        ({"version": 1, **BODY}, "version: 1 has no body frame and no region"),
        ({"version": 1, "block": (*NEUTRAL_BLOCK[:-1], 2.0)}, "version: 1 has no wind"),
        ({"frame": "camera"}, "frame: 'camera'"),
        ({"frame": "body", "layers": (), "weights": ()}, "frame: body needs a network"),
        ({"region": REGION._replace(speed_max_m_s=-1.0)}, "region.speed_max_m_s"),
        ({"region": REGION._replace(tilt_max_rad=4.0)}, "region.tilt_max_rad"),
        ({"region": REGION._replace(thrust_min_m_s2=14.0)}, "region.thrust_max_m_s2"),
        ({"region": (1.0, 2.0)}, "region: has 2"),
        ({"layers": (33,)}, "layers"),
        ({"layers": (4, 4, 4, 4)}, "layers"),
        ({"layers": (4,)}, "weights: .* need 43"),
        ({"weights": [math.nan] * 55}, "weights.0"),
    ],
)
def test_feedforward_built_from_bad_values_names_the_field(changes: dict, field: str) -> None:
    with pytest.raises(BlobError, match=f"^{field}"):
        make_feedforward(**changes)


def test_feedforward_of_origin_minus_zero_is_refused() -> None:
    # Read as 0 and written again it would be another blob, of another id.
    data = bytearray(make_feedforward().to_bytes())
    data[21] = 0x80
    with pytest.raises(BlobError, match=r"^origin: must be 0"):
        FeedForward.from_bytes(bytes(data))


def test_block_and_network_sizes_are_those_of_the_law() -> None:
    from trimtab.firmware_model.law import feedforward

    assert blobs.BLOCK_SIZE + len(TrainedRegion._fields) == feedforward.FF_SIZE
    assert (*blobs.NEUTRAL_BLOCK, *feedforward.OPEN_REGION) == feedforward.NEUTRAL
    assert make_feedforward().layers == (4, 3)
    assert len(make_feedforward().weights) == feedforward.weight_count((4, 3))


@settings(max_examples=300)
@given(
    base=st.sampled_from(
        [
            make_reference().to_bytes(),
            make_feedforward().to_bytes(),
            make_feedforward(version=1).to_bytes(),
            make_feedforward(region=REGION, **BODY).to_bytes(),
        ]
    ),
    edits=st.lists(st.tuples(st.integers(0, 400), st.integers(0, 255)), max_size=6),
    cut=st.integers(0, 500),
    tail=st.binary(max_size=40),
)
def test_corrupted_bytes_raise_only_blob_errors_and_what_parses_is_canonical(base, edits, cut, tail) -> None:
    data = bytearray(base[:cut] + tail)
    for at, value in edits:
        if at < len(data):
            data[at] = value
    try:
        blob = blobs.from_bytes(bytes(data))
    except BlobError:
        return
    assert blob.to_bytes() == bytes(data)


@settings(max_examples=300)
@given(data=st.binary(max_size=300), magic=st.booleans())
def test_arbitrary_bytes_raise_only_blob_errors(data: bytes, magic: bool) -> None:
    with contextlib.suppress(BlobError):
        blobs.from_bytes(b"TRTB" + data if magic else data)


finite = st.floats(-1e6, 1e6, width=32)
nodes = st.lists(st.tuples(st.integers(1, 10**6), st.tuples(*[finite] * 12)), min_size=1, max_size=6).map(
    lambda rows: [Node(sum(t for t, _ in rows[:k]), state) for k, (_, state) in enumerate(rows)]
)


@settings(max_examples=100)
@given(rows=nodes, origin=st.tuples(*[st.floats(-1e9, 1e9)] * 3), yaw=st.lists(finite, max_size=4))
def test_any_reference_survives_both_ways(rows, origin, yaw) -> None:
    rows.append(Node(rows[-1].t_us + 1, (0.0,) * 12))
    yaws = tuple(YawNode(10 * k, value, -value) for k, value in enumerate(yaw))
    reference = make_reference(nodes=tuple(rows), origin_ned=origin, yaws=yaws)
    again = Reference.from_bytes(reference.to_bytes())
    assert again == reference
    assert again.to_bytes() == reference.to_bytes()
