"""pymavlink's mavutil with the vehicle's key, and what a station without it is told."""

from __future__ import annotations

import hashlib
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

pytestmark = [pytest.mark.full, pytest.mark.realtime]

LAND, REAL32 = 21, 9
NEEDS_KEY = "signed messages only: give this station the key"
OTHER_KEY = "wrong signature: this station has another key"
INSTALLED, REMOVED = "signing key installed", "signing key removed"


def passphrase(key_file: Path) -> str:
    return key_file.read_text().strip()


def sign(station: Any, phrase: str) -> None:
    """Give a station of mavutil a key, as ground stations derive it from a passphrase."""
    station.link.setup_signing(hashlib.sha256(phrase.encode()).digest(), sign_outgoing=True)


def test_mavutil_with_the_key_takes_off_and_lands(
    serve_with_key: Callable[..., str], station: Callable[..., Any], key_file: Path
) -> None:
    own = station("udpout:" + serve_with_key())
    sign(own, passphrase(key_file))
    own.answer("HEARTBEAT")
    own.arm()
    own.take_off_and_land()
    assert NEEDS_KEY not in own.texts


def test_mavutil_sets_up_and_removes_a_key_by_cable(
    serve: Callable[..., str], station: Callable[..., Any]
) -> None:
    own = station(serve("pty", sitl=("--world", "wired")))
    own.answer("HEARTBEAT")
    key = hashlib.sha256(b"of a person").digest()
    timestamp = int((time.time() - 1_420_070_400) * 1e5)

    def set_up(secret: bytes, stamp: int) -> Callable[[], None]:
        return lambda: own.link.mav.setup_signing_send(1, 1, list(secret), stamp)

    own.answer("STATUSTEXT", set_up(key, timestamp), lambda m: m.text == INSTALLED)
    own.link.mav.param_set_send(1, 1, b"HOLD_S", 2.0, REAL32)
    own.until(lambda: NEEDS_KEY in own.texts)
    sign(own, "of a person")
    assert own.set_parameter("HOLD_S", 2.5, REAL32).param_value == 2.5
    own.link.disable_signing()  # what the vehicle sends after the removal is unsigned
    own.answer("STATUSTEXT", set_up(bytes(32), 0), lambda m: m.text == REMOVED)
    assert own.set_parameter("HOLD_S", 3.0, REAL32).param_value == 3.0


def test_mavutil_without_the_key_reads_and_is_told_why_it_may_not_command(
    serve_with_key: Callable[..., str], station: Callable[..., Any]
) -> None:
    own = station("udpout:" + serve_with_key())
    assert own.answer("HEARTBEAT").get_srcSystem() == 1
    assert own.parameters()["HOLD_S"] == (1.0, REAL32)
    own.link.mav.command_long_send(1, 1, LAND, 0, *(0.0,) * 7)
    own.until(lambda: NEEDS_KEY in own.texts)
    sign(own, "another one")
    own.link.mav.command_long_send(1, 1, LAND, 0, *(0.0,) * 7)
    own.link.disable_signing()
    own.until(lambda: OTHER_KEY in own.texts)
