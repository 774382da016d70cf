"""Poses forwarded for somebody else's ground station: the vehicle can be armed on them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import pytest

from trimtab.host.base.errors import LinkError
from trimtab.host.link.client import NEVER_US
from trimtab.host.link.poses import SILENT_US, forward_session
from trimtab.protocol.messages import AttPosMocap, FcEstimate, Message
from trimtab.protocol.telemetry import TICK_US


class Estimates:
    """Listens for the ages of the poses that the vehicle uses, in 0.1 ms."""

    deadline_us = NEVER_US

    def __init__(self) -> None:
        self.ages: list[int] = []

    def receive(self, messages: Sequence[Message], now_us: int) -> None:
        self.ages += [message.mocap_age for message in messages if isinstance(message, FcEstimate)]

    def pose(self, message: AttPosMocap, vehicle_us: int, now_us: int) -> None:
        pass

    def link(self, now_us: int) -> None:
        pass


def test_poses_are_forwarded_until_the_vehicle_is_silent(simulate: Callable[..., Any]) -> None:
    vehicle = simulate()
    told: list[int] = []
    found: list[int] = []
    session = forward_session(
        "here",
        4000,
        ready=lambda: found.append(vehicle.now_us),
        look=lambda session: told.append(session.forwarded),
    )
    session.listener = estimates = Estimates()
    now_us = 0
    while now_us < 3_000_000:
        vehicle.serial_write(session.step(now_us, vehicle.serial_read(), vehicle.mocap_read()))
        now_us = vehicle.run_until(max(session.next_deadline_us, now_us + TICK_US))
    assert len(found) == 1
    assert told == sorted(told)
    assert 200 < session.forwarded <= session.poses <= 300
    assert 0 < estimates.ages[-1] < 500  # 50 ms

    while not session.done:
        now_us = max(session.next_deadline_us, now_us + TICK_US)
        session.step(now_us)
    assert isinstance(session.error, LinkError)
    assert SILENT_US < now_us - 3_000_000 < SILENT_US + 2_000_000


def test_poses_without_a_vehicle_says_so(simulate: Callable[..., Any]) -> None:
    session = forward_session("here", 4000, ready=lambda: pytest.fail("found one"), look=lambda session: None)
    now_us = 0
    while not session.done:
        session.step(now_us)
        now_us = max(session.next_deadline_us, now_us + TICK_US)
    assert isinstance(session.error, LinkError)
    assert "no vehicle, nothing was received" in str(session.error)
