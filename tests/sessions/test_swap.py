"""A reference that is sent in flight and takes over: what is flown, what the log says, what it costs."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from trimtab.firmware_model.flight.flight import Flight as Firmware
from trimtab.firmware_model.law.reference import septic
from trimtab.host import cli
from trimtab.host.base.errors import UsageError
from trimtab.host.link.fly import FlightEnded
from trimtab.host.link.summary import FlightResult
from trimtab.host.link.swap import SLOTS_PER_S, swap_time_us
from trimtab.host.log import read_flight, topics
from trimtab.host.log.scan import scan
from trimtab.host.log.tracking import reference_at
from trimtab.protocol.blobs import Node, Reference
from trimtab.protocol.generated import flight_pb2

AT_US = 3_150_000
"""Between two nodes of the first reference, in its quickest part."""
QUIET = {"loss": 0.0, "jitter_us": 0, "duplicate": 0.0, "corrupt": 0.0}

Fly = Callable[..., FlightResult]
Simulate = Callable[..., Any]


def follow(reference: Reference, at_us: int, resting: int = 0) -> Reference:
    """Goes on with the reference at a time, to rest beside it, `resting` nodes long."""
    start = reference_at(reference, np.array([at_us]))[0][:12]
    start[2] -= reference.origin_ned[2]
    rest = (0.9, 0.7, -0.3, *(0.0,) * 9)
    nodes = []
    for k in range(31):
        p, v, a, j, _ = septic(3.0, 0.1 * k, start, rest)
        nodes.append(Node(100_000 * k, (*p, *v, *a, *j)))
    nodes += [Node(3_000_000 + 10_000 * (k + 1), rest) for k in range(resting)]
    return dataclasses.replace(reference, nodes=tuple(nodes), free_ends=True)


@pytest.fixture(scope="session")
def then(reference: Reference) -> Reference:
    """Goes on with the reference at AT_US."""
    return follow(reference, AT_US)


def test_time_of_the_swap_is_the_latest_at_which_one_goes_on_with_the_other(reference, then) -> None:
    assert swap_time_us(reference, then, None) == AT_US
    assert swap_time_us(reference, then, AT_US) == AT_US
    with pytest.raises(UsageError, match=r"at 3\.000 s position jumps by 0\.\d+ at the swap, above 0\.001 m"):
        swap_time_us(reference, then, 3_000_000)
    with pytest.raises(UsageError, match="lasts 6 s, give a time within"):
        swap_time_us(reference, then, 6_000_000)
    with pytest.raises(UsageError, match="where it is nearest, "):
        swap_time_us(reference, reference_beside(then), None)


def reference_beside(then: Reference) -> Reference:
    """The same, a hand's breadth to the east."""
    north, east, down = then.origin_ned
    return dataclasses.replace(then, origin_ned=(north, east + 0.1, down))


def test_flight_with_a_swap_is_logged_as_the_one_composed_reference(
    fly: Fly, reference: Reference, then: Reference, tmp_path: Path
) -> None:
    result = fly(then=then, swap_us=AT_US)
    assert result.end is not None
    assert result.end.whole
    swap = result.to_dict()["swap"]
    assert (swap["happened"], swap["reason"], swap["reference"]) == (True, None, then.id)
    assert swap["at_s"] == pytest.approx(3.15)
    assert 0.1 < swap["upload_s"] < 2.0
    flight = read_flight(result.log)
    assert flight.reference is not None
    assert flight.tracking is not None
    assert flight.tracking == (flight.tracking[0], flight.tracking[0] + AT_US + then.duration_us)
    assert flight.tracking_whole
    # Its path is the first one's, then the second one's.
    t_us = np.arange(0, AT_US + then.duration_us, 7_000)
    first, second = reference_at(reference, t_us), reference_at(then, t_us - AT_US)
    wanted = np.where((t_us < AT_US)[:, None], first, second)
    np.testing.assert_allclose(reference_at(flight.reference, t_us)[:, :9], wanted[:, :9], atol=2e-3)
    # The topic says which one was flown when, to the tick.
    entries = scan(result.log).by_topic()[topics.REFERENCE]
    messages = [flight_pb2.Reference.FromString(entry.data) for entry in entries]
    assert {message.reference_id for message in messages} == {reference.id, then.id}
    for message in messages:
        assert message.reference_us < AT_US or message.reference_id == then.id
    # Flown whole and unswapped, the composed reference is tracked alike.
    whole = fly(reference=flight.reference, log_path=tmp_path / "whole.mcap")
    assert flight.reference.id == read_flight(whole.log).reference_id
    assert result.tracking_rmse_m == pytest.approx(whole.tracking_rmse_m, abs=2e-4)
    assert result.tracking_max_m == pytest.approx(whole.tracking_max_m, abs=2e-3)


def test_upload_that_is_not_done_in_time_leaves_the_first_reference_flown(
    fly: Fly, reference: Reference
) -> None:
    with pytest.raises(FlightEnded, match=r"flown to its end, but \w+ did not take over: ") as caught:
        fly(then=follow(reference, 250_000), swap_us=250_000)
    result = caught.value.result
    assert result.end is not None
    assert result.end.whole
    assert result.end.swap is not None
    assert not result.end.swap.happened
    assert "below 100 ms" in str(result.end.swap.reason)
    flight = read_flight(result.log)
    assert flight.reference == reference
    assert flight.tracking_whole


def test_upload_in_flight_takes_its_share_of_the_slots_and_delays_poses_by_one_at_most(
    fly: Fly, simulate: Simulate, reference: Reference, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The same flight with and without an upload, on a radio without chance: only the upload differs."""
    then = follow(reference, AT_US, resting=370)
    assert len(then.to_bytes()) > 20_800
    arrivals: list[dict[int, int]] = []
    frames: list[list[tuple[int, int]]] = []
    take = Firmware.pose
    simulated: Any = None

    def pose(self: Firmware, time_us: int, p: Any, q: Any, now_us: int) -> bool:
        arrivals[-1].setdefault(round(time_us, -4), now_us)
        frames[-1].append((now_us, sum(way["sent"] for way in simulated.radio_counts().values())))
        return take(self, time_us, p, q, now_us)

    monkeypatch.setattr(Firmware, "pose", pose)
    results = []
    for name, options in (("with", {"then": then, "swap_us": AT_US}), ("without", {})):
        arrivals.append({})
        frames.append([])
        simulated = simulate(radio=QUIET)
        results.append(fly(simulated, log_path=tmp_path / f"{name}.mcap", **options))
    # Frames in the air from the start of tracking until the tick was agreed, over those without.
    flight = read_flight(results[0].log)
    assert flight.tracking is not None
    begin_us = flight.tracking[0] + int(flight.metadata["arm_host_us"])
    swap = results[0].to_dict()["swap"]
    end_us = begin_us + round(1e6 * swap["upload_s"])
    shared = sorted(t for t in arrivals[0].keys() & arrivals[1].keys() if begin_us <= t <= end_us)
    late = [arrivals[0][t] - arrivals[1][t] for t in shared]
    assert len(late) > 150
    assert 0 < max(late) <= 2_000
    passed = [np.interp([begin_us, end_us], *np.array(rows).T) for rows in frames]
    extra = float(np.diff(passed[0])[0] - np.diff(passed[1])[0])
    slots = SLOTS_PER_S * swap["upload_s"]
    # What the host tells is an upper bound: some answers travel in frames that would have gone anyway.
    assert 0.1 < extra / slots <= swap["slots_share"] <= 0.30


def test_then_that_does_not_go_on_is_refused_before_the_flight(
    reference: Reference, then: Reference, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Any
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("a.ref").write_bytes(reference.to_bytes())
    Path("b.ref").write_bytes(reference_beside(then).to_bytes())
    assert cli.main(["fly", "a.ref", "--then", "b.ref", "--at", "3.15"]) == 2
    assert "at 3.150 s position jumps by 0.1 at the swap, above 0.001 m" in " ".join(
        capsys.readouterr().err.split()
    )
    assert not list(tmp_path.glob("*.mcap"))
    for at in ("nan", "inf", "1e308"):
        assert cli.main(["fly", "a.ref", "--then", "b.ref", "--at", at]) == 2
        (line,) = capsys.readouterr().err.splitlines()
        assert "is not a time; give seconds of the first reference" in line
    assert cli.main(["fly", "a.ref", "--at", "3"]) == 2
