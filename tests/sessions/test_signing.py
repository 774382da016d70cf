"""Whole sessions with a key: flights, uploads, downloads and key set-up, in lock-step."""

from __future__ import annotations

import dataclasses
import hashlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from trimtab.host.base.errors import LinkError, TrimtabError
from trimtab.host.link.download import download_lockstep
from trimtab.host.link.drivers import run_lockstep
from trimtab.host.link.key_setup import key_session
from trimtab.host.link.keys import StationKey, read_key
from trimtab.host.link.session import Session
from trimtab.host.link.summary import FlightResult
from trimtab.host.link.upload import upload_lockstep
from trimtab.host.log import read_flight
from trimtab.protocol import messages as m
from trimtab.protocol.blobs import Reference
from trimtab.protocol.codec import Codec
from trimtab.protocol.signing import SIMULATED_EPOCH, Signer, SigningKey
from trimtab.protocol.stream import SIGNED_FLAG, message_id, split
from trimtab.protocol.uwb_pieces import PIECE

KEY = StationKey(key=SigningKey(bytes(range(32))), name="lab.key")
OTHER = StationKey(key=SigningKey(bytes(range(1, 33))), name="other.key")
UNSIGNED = {m.RadioStats.id}
Fly = Callable[..., FlightResult]
Simulate = Callable[..., Any]
Run = Callable[..., tuple[int, dict[str, Any], str]]


def drive(session: Session, simulated: Any) -> Any:
    run_lockstep(session, simulated)
    return session.outcome()


def test_signed_flight_is_flown_whole_with_every_message_signed(
    fly: Fly, simulate: Simulate, tmp_path: Path
) -> None:
    simulated = simulate(key=KEY.key)
    frames: list[bytes] = []
    simulated.watch_air(lambda now_us, frame: frames.append(frame))
    result = fly(simulated, key=KEY)
    assert result.end is not None
    assert result.end.whole
    assert result.tracking_rmse_m is not None
    assert result.tracking_rmse_m < 0.15
    messages = [message for frame in frames for message in split(frame)]
    unsigned = {message_id(message) for message in messages if not message[2] & SIGNED_FLAG}
    assert unsigned == UNSIGNED
    assert not [frame for frame in frames if frame[0] == PIECE]
    assert read_flight(tmp_path / "flight.mcap").tracking_whole


def test_signed_flight_gives_the_same_bytes_again_and_holds_no_key(
    fly: Fly, simulate: Simulate, tmp_path: Path
) -> None:
    logs = [tmp_path / "one.mcap", tmp_path / "two.mcap"]
    for log in logs:
        fly(simulate(key=KEY.key), key=KEY, log_path=log)
    one, two = (log.read_bytes() for log in logs)
    assert one == two
    assert KEY.key.secret not in one
    assert KEY.key.secret.hex().encode() not in one


def test_second_signed_flight_after_a_power_cycle_begins_by_following_the_vehicles_clock(
    fly: Fly, simulate: Simulate, tmp_path: Path
) -> None:
    simulated = simulate(key=KEY.key)
    fly(simulated, key=KEY)
    assert simulated.store.signing.used > SIMULATED_EPOCH + 1_000_000
    simulated.power_cycle(1)
    result = fly(simulated, key=KEY, log_path=tmp_path / "second.mcap")
    assert result.end is not None
    assert result.end.whole


def test_signed_upload_and_download_use_no_pieces(simulate: Simulate, reference: Reference) -> None:
    simulated = simulate(key=KEY.key)
    frames: list[bytes] = []
    simulated.watch_air(lambda now_us, frame: frames.append(frame))
    assert upload_lockstep(reference, simulated, key=KEY).id == reference.id
    assert download_lockstep("reference", simulated, key=KEY).data == reference.to_bytes()
    assert not [frame for frame in frames if frame[0] == PIECE]
    longest = max(len(frame) for frame in frames)
    assert longest == 116


def test_swap_in_a_signed_flight_takes_over(
    fly: Fly, simulate: Simulate, reference: Reference, figure_eight: Callable[..., Reference]
) -> None:
    at_us = 3_000_000
    after = [node for node in reference.nodes if node.t_us >= at_us]
    nodes = tuple(node._replace(t_us=node.t_us - at_us) for node in after)
    then = dataclasses.replace(reference, nodes=nodes, free_ends=True)
    result = fly(simulate(key=KEY.key), key=KEY, then=then, swap_us=at_us)
    swap = result.to_dict()["swap"]
    assert swap["happened"], swap["reason"]


def test_vehicle_with_a_key_tells_a_host_without_one(fly: Fly, simulate: Simulate) -> None:
    with pytest.raises(LinkError, match="give its key with --key FILE"):
        fly(simulate(key=KEY.key))


def test_vehicle_with_another_key_is_named(fly: Fly, simulate: Simulate) -> None:
    with pytest.raises(LinkError, match=r"another key than lab\.key"):
        fly(simulate(key=OTHER.key), key=KEY)


def test_vehicle_without_a_key_is_named(fly: Fly, simulate: Simulate) -> None:
    with pytest.raises(LinkError, match=r"the vehicle has no key; install lab\.key"):
        fly(simulate(), key=KEY)


def test_key_is_installed_replaced_and_revoked_over_a_wired_port(simulate: Simulate) -> None:
    simulated = simulate(world="wired")
    store = simulated.store
    for key in (KEY, OTHER, None, None):
        drive(key_session(key, "here", SIMULATED_EPOCH), simulated)
        assert store.signing.key == (None if key is None else key.key)
        simulated.power_cycle(0)
        store = simulated.store
        assert store.signing.key == (None if key is None else key.key)


def test_key_is_not_installed_over_radio_and_the_reason_is_told(simulate: Simulate) -> None:
    simulated = simulate()
    with pytest.raises(LinkError, match="connect the vehicle by cable"):
        drive(key_session(KEY, "here", SIMULATED_EPOCH), simulated)
    assert simulated.store.signing.key is None


def test_key_stays_when_a_revocation_comes_over_radio(simulate: Simulate) -> None:
    simulated = simulate(key=KEY.key)
    with pytest.raises(LinkError, match="connect the vehicle by cable"):
        drive(key_session(None, "here", 0), simulated)
    assert simulated.store.signing.key == KEY.key


def test_command_line_flies_a_simulated_vehicle_with_a_key_and_no_trace_of_it(
    run_trimtab: Run, reference: Reference, tmp_path: Path
) -> None:
    (tmp_path / "eight.ref").write_bytes(reference.to_bytes())
    assert run_trimtab("key", "new", "lab.key")[0] == 0
    secret = read_key(tmp_path / "lab.key").key.secret
    text = (tmp_path / "lab.key").read_bytes().strip()
    digests = set()
    for _ in range(2):
        words = ("fly", "eight.ref", "--key", "lab.key", "-o", "x.mcap", "--force", "--json")
        code, told, complaint = run_trimtab(*words)
        assert code == 0, complaint
        assert told["whole"]
        log = (tmp_path / "x.mcap").read_bytes()
        digests.add(hashlib.sha256(log).hexdigest())
        for needle in (secret, secret.hex().encode(), text, b"lab.key"):
            assert needle not in log
    assert len(digests) == 1
    assert not (tmp_path / "lab.key.used").exists()


def test_command_line_refuses_a_key_that_others_can_read(
    run_trimtab: Run, reference: Reference, tmp_path: Path
) -> None:
    (tmp_path / "eight.ref").write_bytes(reference.to_bytes())
    run_trimtab("key", "new", "lab.key")
    (tmp_path / "lab.key").chmod(0o644)
    code, _, complaint = run_trimtab("fly", "eight.ref", "--key", "lab.key")
    assert code == 2
    assert "chmod 600 lab.key" in complaint
    assert len(complaint.splitlines()) == 1


class Attacker:
    """Sends unsigned, wrongly signed and recorded messages beside the host, every 20 ms."""

    def __init__(self, simulated: Any) -> None:
        self.sent = 0
        self._simulated = simulated
        self._run = simulated.run_until
        self._next_us = 0
        self._recorded: list[bytes] = []
        self._plain = Codec(*m.HOST)
        self._wrong = Codec(*m.HOST)
        self._wrong.signer = Signer(OTHER.key, link_id=0, epoch=SIMULATED_EPOCH + 10**12)
        simulated.watch_air(self._record)
        simulated.run_until = self.run_until

    def _record(self, now_us: int, frame: bytes) -> None:
        self._recorded += [message for message in split(frame) if message[5] == m.HOST[0]]

    def run_until(self, t_us: int) -> int:
        now_us = self._simulated.now_us
        if now_us >= self._next_us:
            self._next_us = now_us + 20_000
            self._simulated.serial_write(self._attack(now_us))
        return self._run(t_us)

    def _attack(self, now_us: int) -> bytes:
        kill = m.CommandLong(*m.VEHICLE, 400, 0, 0.0, m.FORCE, *[0.0] * 5)
        end = m.CommandLong(*m.VEHICLE, 185, 0, 1.0, *[0.0] * 6)
        pose = m.AttPosMocap(now_us + 30_000, [1.0, 0.0, 0.0, 0.0], 5.0, 5.0, -5.0)
        choice = (kill, end, pose, m.ParamSet(1, 1, b"FS_LINK_S", 0.1, 9))[self.sent % 4]
        self.sent += 1
        old = self._recorded[self.sent % len(self._recorded)] if self._recorded else b""
        return self._plain.encode(choice) + self._wrong.encode(choice) + old


def test_attacker_without_the_key_changes_nothing_in_a_signed_flight(fly: Fly, simulate: Simulate) -> None:
    simulated = simulate(key=KEY.key)
    attacker = Attacker(simulated)
    result = fly(simulated, key=KEY)
    assert attacker.sent > 500
    assert result.end is not None
    assert result.end.whole
    assert result.tracking_rmse_m is not None
    assert result.tracking_rmse_m < 0.15


def test_attacker_without_the_key_ends_an_unsigned_flight(fly: Fly, simulate: Simulate) -> None:
    simulated = simulate()
    Attacker(simulated)
    with pytest.raises(TrimtabError):
        fly(simulated)
