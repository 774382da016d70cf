"""The frames of a flight, counted in the air, are those of the budget that the link's page states."""

from __future__ import annotations

import re
from collections import Counter
from pathlib import Path
from typing import Any

import pytest

from trimtab.host.link.keys import StationKey
from trimtab.host.vehicle import load_vehicle
from trimtab.protocol.messages import FcControl, FcEstimate, FcObserver, FcRotors, FcStatus
from trimtab.protocol.signing import SigningKey
from trimtab.protocol.stream import StreamSplitter, message_id
from trimtab.sitl.vehicle import SimulatedVehicle

PAGE = Path(__file__).parent.parent.parent / "docs" / "concepts" / "link.md"
POSE = 138
STATES_IN_FLIGHT = range(3, 7)


def budget(column: int = 3) -> list[int]:
    """Frames a second of the page's rows: poses, control, estimate, everything else, all, left, setpoints.

    `column` 5 is that of signed messages.
    """
    part = PAGE.read_text(encoding="utf-8").split("## Air budget\n", 1)[1]
    rows = re.search(r"(?:^\|.*\n)+", part, flags=re.MULTILINE)
    assert rows is not None
    cells = [row.strip("|").split("|")[column].strip(" *") for row in rows[0].splitlines()[2:]]
    return [int(cell.partition(" ")[0]) for cell in cells]


def count_frames(simulated: Any, counts: Counter[str]) -> None:
    """Counts every frame that either radio hands to the air in flight by what it carries."""
    for radio in (simulated._ground_radio, simulated._air_radio):
        send = radio.air_send

        def counted(now_us: int, send: Any = send) -> bytes | None:
            frame = send(now_us)
            if frame is not None and simulated._flight_mcu.state in STATES_IN_FLIGHT:
                ids = [message_id(message) for message in StreamSplitter().feed(frame)]
                kinds = {
                    **{POSE: "pose", FcControl.id: "control", FcEstimate.id: "estimate"},
                    FcObserver.id: "observer",
                    FcRotors.id: "rotors",
                }
                counts[next((kind for number, kind in kinds.items() if number in ids), "other")] += 1
            return frame

        radio.air_send = counted


def test_flight_takes_the_frames_of_the_budget(session_tools: Any) -> None:
    figure_eight, put_on_board, fly = session_tools
    vehicle = load_vehicle("research")
    simulated = SimulatedVehicle.create(vehicle, world="empty", world_seed=8403)
    put_on_board(simulated, figure_eight(vehicle))
    counts: Counter[str] = Counter()
    count_frames(simulated, counts)
    session = fly(simulated)
    ticks = [m.tick for m in session.messages if isinstance(m, FcStatus) and m.state in STATES_IN_FLIGHT]
    seconds = (max(ticks) - min(ticks)) * 1e-3
    assert seconds > 10.0
    poses, control, estimate, other, everything, left, _ = budget()
    assert counts["pose"] / seconds == pytest.approx(poses, rel=0.02)
    assert counts["control"] / seconds == pytest.approx(control, rel=0.02)
    assert counts["estimate"] / seconds == pytest.approx(estimate, rel=0.02)
    assert 5.0 < counts["other"] / seconds < other
    used = sum(counts.values()) / seconds
    assert used < everything
    assert 500 - used > left
    print({kind: round(count / seconds, 1) for kind, count in counts.items()}, round(used, 1))


@pytest.mark.parametrize(
    ("signed", "observer", "rate", "frames"),
    [(False, False, 100, 0), (False, True, 50, 50), (True, False, 50, 50), (True, True, 50, 50)],
)
def test_rotor_speeds_take_the_frames_that_the_page_states(
    session_tools: Any, signed: bool, observer: bool, rate: int, frames: int
) -> None:
    """frames: a second beside poses, control and estimate, with the observer's where it has its own."""
    figure_eight, put_on_board, fly = session_tools
    vehicle = load_vehicle("research").replace(sensors={"rotor_speed": True})
    key = StationKey(key=SigningKey(bytes(range(32))), name="lab.key") if signed else None
    simulated = SimulatedVehicle.create(
        vehicle, world="empty", world_seed=8403, key=None if key is None else key.key
    )
    if observer:
        simulated.store.settings.change("OBS_GAIN", 2.0)
    put_on_board(simulated, figure_eight(vehicle))
    counts: Counter[str] = Counter()
    count_frames(simulated, counts)
    session = fly(simulated, key=key)
    ticks = [m.tick for m in session.messages if isinstance(m, FcStatus) and m.state in STATES_IN_FLIGHT]
    seconds = (max(ticks) - min(ticks)) * 1e-3
    sent = [m.tick for m in session.messages if isinstance(m, FcRotors) and min(ticks) <= m.tick < max(ticks)]
    assert len(sent) / seconds == pytest.approx(rate, rel=0.03)
    assert counts["estimate"] / seconds == pytest.approx(100, rel=0.03)
    own = counts["rotors"] + (counts["observer"] if signed else 0)
    assert own / seconds == pytest.approx(frames, rel=0.1, abs=2.0)
    used = sum(counts.values()) / seconds
    assert used < budget(5 if signed else 3)[4] + frames
    print({kind: round(count / seconds, 1) for kind, count in counts.items()}, round(used, 1))


@pytest.mark.parametrize("observer", [False, True])
def test_signed_flight_takes_the_frames_of_the_budget(session_tools: Any, observer: bool) -> None:
    figure_eight, put_on_board, fly = session_tools
    vehicle = load_vehicle("research")
    key = StationKey(key=SigningKey(bytes(range(32))), name="lab.key")
    simulated = SimulatedVehicle.create(vehicle, world="empty", world_seed=8403, key=key.key)
    if observer:
        simulated.store.settings.change("OBS_GAIN", 2.0)
    put_on_board(simulated, figure_eight(vehicle))
    counts: Counter[str] = Counter()
    count_frames(simulated, counts)
    session = fly(simulated, key=key)
    ticks = [m.tick for m in session.messages if isinstance(m, FcStatus) and m.state in STATES_IN_FLIGHT]
    seconds = (max(ticks) - min(ticks)) * 1e-3
    assert seconds > 10.0
    poses, control, estimate, other, everything, _, _ = budget(5)
    assert counts["pose"] / seconds == pytest.approx(poses, rel=0.02)
    assert counts["control"] / seconds == pytest.approx(control, rel=0.02)
    with_observer = estimate if observer else estimate - 50
    assert (counts["estimate"] + counts["observer"]) / seconds == pytest.approx(with_observer, rel=0.03)
    assert 5.0 < counts["other"] / seconds < other
    used = sum(counts.values()) / seconds
    assert used < everything
    print({kind: round(count / seconds, 1) for kind, count in counts.items()}, round(used, 1))
