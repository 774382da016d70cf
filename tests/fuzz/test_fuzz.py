"""Inputs of all kinds: 10^4 in `make test`, also 5 × 10^4 in `make test-all`; what the fuzzer must notice."""

from __future__ import annotations

import math
from collections.abc import Callable
from random import Random
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from trimtab.firmware_model.flight.supervisor import State
from trimtab.firmware_model.mcu.flight_mcu import FlightMcu
from trimtab.firmware_model.services.commands import Commands
from trimtab.firmware_model.services.handlers import Handlers
from trimtab.firmware_model.services.parameter_service import ParameterService
from trimtab.firmware_model.storage.store import ReferenceStore
from trimtab.host.link.client import Client
from trimtab.protocol import uwb
from trimtab.protocol.codec import Codec
from trimtab.protocol.messages import HOST, CommandLong, ParamSet, StatusText
from trimtab.protocol.stream import StreamSplitter, split
from trimtab.sitl.studies.fuzz import KINDS, FuzzReport, replay, run, run_fuzz
from trimtab.sitl.studies.fuzz.__main__ import main
from trimtab.sitl.studies.fuzz.inputs import FLUSH, frame, pack, valid_messages
from trimtab.sitl.studies.fuzz.source import record

INPUTS = [10_000, pytest.param(50_000, marks=pytest.mark.full)]
SEED = 20_261
GROUPS = (
    ("vehicle-bytes",),
    ("vehicle-messages",),
    ("vehicle-recording", "radio"),
    ("host-bytes", "host-messages", "host-recording", "mocap"),
    ("blobs", "texts", "logs"),
)


@pytest.fixture(scope="module", autouse=True)
def _recorded() -> None:
    """The session that inputs are made from flies before any test changes the code."""
    record()


@pytest.mark.parametrize("inputs", INPUTS)
@pytest.mark.parametrize("kinds", GROUPS, ids=lambda kinds: "+".join(kinds))
def test_inputs_bring_about_no_crash_and_no_change_without_a_valid_message(
    kinds: tuple[str, ...], inputs: int
) -> None:
    share = sum(KINDS[kind].share for kind in kinds)
    report = run_fuzz(inputs * share // 1000, SEED, kinds=kinds)
    assert report.inputs == inputs * share // 1000
    assert report.valid > report.inputs // 100
    assert [f"{crash.kind}:{crash.index} {crash.error} {crash.data}" for crash in report.crashes] == []


def test_groups_are_all_kinds_and_all_inputs() -> None:
    assert sorted(kind for kinds in GROUPS for kind in kinds) == sorted(KINDS)
    assert sum(kind.share for kind in KINDS.values()) == 1000


def test_same_seed_gives_the_same_report_however_many_processes() -> None:
    kinds = ("vehicle-bytes", "mocap")
    assert run_fuzz(1_300, 5, kinds=kinds) == run_fuzz(1_300, 5, kinds=kinds, workers=2)


# What it must notice: each fault is put into the real code.


@pytest.fixture
def _one_crash_a_batch(monkeypatch: pytest.MonkeyPatch) -> None:
    """End a batch at its first crash: behind each, fresh vehicles boot."""
    monkeypatch.setattr(run, "CRASHES_MAX", 1)


def _crashes(kind: str, inputs: int = 2_000) -> FuzzReport:
    return run_fuzz(inputs, 6, kinds=(kind,))


def _raises_on_odd_numbers(before: Callable[..., Any]) -> Callable[..., Any]:
    def act(self: Any, message: CommandLong, now_us: int) -> Any:
        int(message.param7)  # NaN has no whole number
        return before(self, message, now_us)

    return act


@pytest.mark.usefixtures("_one_crash_a_batch")
def test_exception_of_a_handler_is_found_and_can_be_replayed(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Any
) -> None:
    monkeypatch.setattr(Commands, "long", _raises_on_odd_numbers(Commands.long))
    crash = _crashes("vehicle-messages", 3_000).crashes[0]
    assert "NaN" in crash.error or "infinity" in crash.error
    again = replay(crash.kind, crash.seed, crash.index)
    assert again is not None
    assert (again.error, again.data) == (crash.error, crash.data)
    words = ["--inputs", "3000", "--seed", "6", "--kinds", "vehicle-messages", "--save", str(tmp_path)]
    assert main(words) == 1
    assert (tmp_path / f"fuzz-{crash.kind}-6-{crash.index}.hex").read_text().strip() == crash.data
    assert main(["--seed", "6", "--replay", f"{crash.kind}:{crash.index}"]) == 1
    monkeypatch.undo()
    assert main(["--seed", "6", "--replay", f"{crash.kind}:{crash.index}"]) == 0
    assert capsys.readouterr().out.endswith("no crash\n")


@pytest.mark.usefixtures("_one_crash_a_batch")
def test_message_for_another_vehicle_that_is_obeyed_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    def receive(self: Any, message: Any, now_us: int) -> None:
        if hasattr(message, "target_system"):
            message.target_system = 1
        before(self, message, now_us)

    before = Handlers.receive
    monkeypatch.setattr(Handlers, "receive", receive)
    assert "valid messages alone" in _crashes("vehicle-messages").crashes[0].error


@pytest.mark.usefixtures("_one_crash_a_batch")
def test_parameter_set_in_flight_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    def set_always(self: Any, message: ParamSet, now_us: int) -> None:
        if message.param_id in self._parameters:
            self._set(message.param_id, message.param_value, (255, 190), now_us)

    monkeypatch.setattr(ParameterService, "set", set_always)
    assert any("a parameter changed in" in crash.error for crash in _crashes("vehicle-messages").crashes)


@pytest.mark.usefixtures("_one_crash_a_batch")
def test_message_counted_before_its_checksum_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    def decode(self: Codec, data: bytes) -> list[Any]:
        found = before(self, data)
        if self.bad_checksums:
            found.append(ParamSet(1, 1, b"MASS", 0.8, 9))
        return found

    before = Codec.decode
    monkeypatch.setattr(Codec, "decode", decode)
    found = _crashes("vehicle-recording").crashes
    assert any("parameters" in crash.error for crash in found)


def test_blob_made_live_before_its_commit_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    def stage(self: ReferenceStore, kind: int, blob: bytes) -> str:
        digest = before(self, kind, blob)
        self.commit(kind)
        return digest

    def commit(self: ReferenceStore, kind: int) -> bytes | None:
        return before_commit(self, kind) if self.staged(kind) is not None else self.live(kind)

    before, before_commit = ReferenceStore.stage, ReferenceStore.commit
    monkeypatch.setattr(ReferenceStore, "stage", stage)
    monkeypatch.setattr(ReferenceStore, "commit", commit)
    assert any("live blob" in crash.error for crash in _crashes("vehicle-messages", 12_000).crashes)


def test_rotors_that_turn_in_standby_are_found(monkeypatch: pytest.MonkeyPatch) -> None:
    def tick(self: FlightMcu, *arguments: Any) -> None:
        before(self, *arguments)
        if self.state is State.STANDBY:
            self.motor_command[0] = 0.1

    before = FlightMcu.tick
    monkeypatch.setattr(FlightMcu, "tick", tick)
    with pytest.raises(Exception, match="rotors turn in STANDBY"):
        _crashes("vehicle-bytes", 10)


@pytest.mark.usefixtures("_one_crash_a_batch")
def test_host_that_answers_to_noise_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    def receive(self: Client, data: bytes, now_us: int) -> list[Any]:
        found = before(self, data, now_us)
        if self.codec.bad_checksums:
            self.texts.append((6, "noise"))
        return found

    before = Client.receive
    monkeypatch.setattr(Client, "receive", receive)
    assert "state differs" in _crashes("host-recording").crashes[0].error


def test_long_messages_leave_the_ground_radio_in_pieces() -> None:
    """Inputs 45 and 233, among others, are longer than a frame."""
    assert run_fuzz(400, 77_000, kinds=("radio",)).crashes == ()


@pytest.mark.usefixtures("_one_crash_a_batch")
def test_pieces_that_make_no_message_are_found(monkeypatch: pytest.MonkeyPatch) -> None:
    def split_message(message: bytes, number: int, frame_bytes: int = uwb.FRAME_BYTES) -> list[bytes]:
        return [piece[:-1] for piece in before(message, number, frame_bytes)]

    before = uwb.split_message
    monkeypatch.setattr(uwb, "split_message", split_message)
    crashes = _crashes("radio").crashes
    assert crashes
    assert all("the ground radio sends 02" in crash.error for crash in crashes)


# The measure itself.


@given(text=st.binary(max_size=50), noise=st.binary(max_size=40), cut=st.integers(0, 60))
def test_measure_finds_what_the_codec_finds(text: bytes, noise: bytes, cut: int) -> None:
    whole = Codec(*HOST).encode(StatusText(6, text))
    data = noise + whole + whole[:cut] + whole + noise
    splitter = StreamSplitter()
    assert [one.frame for one in valid_messages(data + FLUSH)] == splitter.feed(data + FLUSH)


@given(noise=st.binary(max_size=20), flags=st.sampled_from((0, 1)), cut=st.integers(0, 60))
def test_measure_finds_what_a_datagram_holds(noise: bytes, flags: int, cut: int) -> None:
    whole = frame(StatusText.id, pack(StatusText.id, text=b"ready"), flags=flags)
    data = whole + noise + whole[:cut] + whole[: len(whole) - cut]
    assert [one.frame for one in valid_messages(data)] == split(data)


def test_measure_of_bytes_with_any_place_damaged_is_no_message() -> None:
    rng = Random(3)
    whole = Codec(*HOST).encode(CommandLong(1, 1, 400, 0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, math.pi))
    assert [one.message.get_type() for one in valid_messages(whole)] == ["COMMAND_LONG"]
    for at in range(len(whole)):
        damaged = bytearray(whole)
        damaged[at] ^= 1 << rng.randrange(8)
        assert valid_messages(bytes(damaged) + FLUSH) == []
