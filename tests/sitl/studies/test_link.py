"""The study of the link: its figures, uploads over lossy air, interrupted ones, and the picture."""

from __future__ import annotations

from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import pytest

from trimtab.host.base.errors import UsageError
from trimtab.host.link import swap
from trimtab.protocol.blobs import Kind, Reference
from trimtab.protocol.signing import SigningKey
from trimtab.protocol.upload import UploadSender
from trimtab.sitl.studies import link, upload_flight, upload_picture
from trimtab.sitl.studies.upload_blob import reference_blob
from trimtab.sitl.studies.upload_cuts import INTERRUPTIONS, interrupt
from trimtab.sitl.studies.upload_peers import StopAndWait, peer_s
from trimtab.sitl.studies.upload_rig import UploadRig
from trimtab.sitl.studies.uploads import CHANNELS, bound_s, figures, percentile, time_upload
from trimtab.sitl.world import RadioSettings

ROOT = Path(__file__).parents[3]
SEED = 9001


def rig(**options: Any) -> UploadRig:
    old, new = (reference_blob("research", k) for k in (0, 1))
    return UploadRig(new, old=old, radio=CHANNELS["upload"], seed=SEED, number=0, **options)


def test_blob_is_a_reference_of_the_size_that_the_targets_name() -> None:
    blob = reference_blob("research", 1)
    assert len(blob) == 20_806
    assert len(Reference.from_bytes(blob).nodes) == 399
    assert blob != reference_blob("research", 2)


def test_bound_is_the_time_of_the_slots_that_chunks_take() -> None:
    radio = RadioSettings(loss=0.1, slot_us=2000)
    assert bound_s(20_800, radio) == pytest.approx(211 * 0.002 / 0.9)


def test_round_trip_of_the_channel_is_twenty_milliseconds() -> None:
    answered = [time_upload("clean", SEED, number)["answered_s"] for number in range(5)]
    assert 0.020 <= min(answered) <= 0.022


def test_upload_over_lossy_air_is_live_soon_after_the_bound() -> None:
    rows = [time_upload("upload", SEED, number) for number in range(6)]
    found = figures(rows)
    assert found["failed"] == 0
    bound = bound_s(20_806, CHANNELS["upload"])
    assert isinstance(found["mean_s"], float)
    assert bound < found["mean_s"] < 0.7
    assert rows == [time_upload("upload", SEED, number) for number in range(6)]


def test_signed_upload_over_lossy_air_takes_at_most_a_fifth_longer() -> None:
    key = SigningKey(bytes(range(1, 33)))
    plain, signed = (
        figures([time_upload("upload", SEED, number, key=one) for number in range(20)]) for one in (None, key)
    )
    assert (plain["failed"], signed["failed"]) == (0, 0)
    assert isinstance(plain["mean_s"], float)
    assert isinstance(signed["mean_s"], float)
    print(f"unsigned {plain['mean_s']:.3f} s, signed {signed['mean_s']:.3f} s")
    assert 1.0 < signed["mean_s"] / plain["mean_s"] <= 1.20


def test_upload_over_clean_air_sends_every_chunk_once() -> None:
    quiet = CHANNELS["clean"].model_copy(update={"corrupt": 0.0, "duplicate": 0.0})
    upload = UploadRig(reference_blob("research", 1), old=None, radio=quiet, seed=SEED, number=1)
    upload.run(10_000_000)
    assert upload.live == upload.blob
    assert upload.sender.chunks_sent == upload.sender.chunks == 211


@pytest.mark.parametrize("number", range(2))
def test_interrupted_upload_goes_on_where_it_was(number: int) -> None:
    trial = interrupt(SEED, number)
    for kind in INTERRUPTIONS:
        assert not trial[kind]["failed"], (kind, trial)


def test_vehicle_that_forgets_is_found_out() -> None:
    """The trial's own measure: with memory wiped in the reset, chunks that arrived are sent again."""
    upload = rig()
    upload.run(upload.begin_us + 300_000)
    held = upload.sender.held
    upload.vehicle.store.discard(Kind.REFERENCE)
    upload.vehicle.reset(upload.now_us)
    before = upload.sender.chunks_sent
    upload.run(60_000_000)
    assert upload.live == upload.blob
    assert held > 50
    assert upload.sender.chunks_sent - before >= upload.sender.chunks


def test_upload_of_a_refused_reference_leaves_the_old_one_live() -> None:
    spoilt = bytearray(reference_blob("research", 1))
    spoilt[4 + 46 + 52 * 100 : 4 + 46 + 52 * 100 + 4] = b"\x00\x00\x48\x43"  # 200 m away
    old = reference_blob("research", 0)
    upload = UploadRig(bytes(spoilt), old=old, radio=CHANNELS["upload"], seed=SEED, number=0)
    upload.run(20_000_000)
    assert upload.sender.reason.startswith("refused on board")
    assert upload.live == old


def test_window_is_kept() -> None:
    upload = rig(make_sender=lambda blob: UploadSender(blob, Kind.REFERENCE, window=4))
    upload.run(60_000_000)
    assert upload.live == upload.blob


def test_percentile_is_exceeded_by_at_most_the_rest() -> None:
    values = [float(k) for k in range(1, 201)]
    assert percentile(values, 0.99) == 198.0
    assert percentile([3.0], 0.99) == 3.0


def test_figures_of_a_failed_upload_are_absent() -> None:
    found = figures([{"seconds": 0.5}, {"seconds": None}])
    assert found["failed"] == 1
    assert found["mean_s"] is None


def test_stop_and_wait_without_loss_takes_a_round_trip_a_message() -> None:
    clean = RadioSettings(loss=0.0)
    one = StopAndWait(data_bytes=100, frames=1, timeout_s=0.5)
    assert peer_s(one, 1_000, clean, 0.02, 1) == pytest.approx(0.2)
    lossy = RadioSettings(loss=0.1, burst_frames=1.2)
    assert peer_s(one, 1_000, lossy, 0.02, 1) > 0.2


def test_quick_study_ends_with_the_figures_and_goes_on_where_it_was(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(link, "QUICK_RUNS", 2)
    monkeypatch.setattr(link, "QUICK_TRIALS", 1)
    monkeypatch.setattr(link, "QUICK_FLIGHTS", 1)
    monkeypatch.setattr(link, "QUICK_FUZZ_INPUTS", 20)
    order: dict[str, Any] = {"folder": tmp_path, "vehicle": "research", "jobs": 1, "quick": True}
    outcome = link.run(seed=SEED, **order)
    answer = outcome["answer"]
    assert answer["cut_trials"] == 3
    assert answer["cut_failures"] == answer["uploads_failed"] == 0
    assert answer["fuzz_inputs"] == 20
    assert (answer["flights"], answer["flights_failed"]) == (2, 0)
    assert 0.1 < answer["flight_slot_share"] <= 0.30
    assert 0 < answer["flight_mocap_delay_max_us"] <= 2_000
    assert 1.5 < answer["flight_upload_s"] < 3.0
    assert answer["upload_mean_s"] > answer["bound_s"]
    assert (tmp_path / "upload.svg").is_file()
    monkeypatch.setattr(link, "do", lambda part, seed: pytest.fail("done before"))
    assert link.run(seed=SEED, **order)["answer"] == answer
    with pytest.raises(UsageError, match="another seed"):
        link.run(seed=SEED + 1, **order)


def test_reference_sent_in_flight_is_of_the_size_that_the_targets_name() -> None:
    first, then, at_us = upload_flight.references()
    assert len(then.to_bytes()) == 20_806
    assert swap.swap_time_us(first, then, at_us) == at_us


def test_picture_in_the_docs_is_that_of_the_code() -> None:
    assert (ROOT / "docs" / "concepts" / "upload.svg").read_text("utf-8") == upload_picture.picture(), (
        "run `make docs`"
    )


def test_picture_shows_losses_repeats_and_the_cut() -> None:
    texts = [node.text or "" for node in ElementTree.fromstring(upload_picture.picture()).iter()]
    joined = "\n".join(texts)
    for said in (
        "BEGIN",
        "chunk 0",
        "again",
        "link cut",
        "STATUS 0 held",
        "VERDICT accepted",
        "COMMIT",
        "LIVE",
    ):
        assert said in joined


@pytest.mark.full
def test_thirty_uploads_meet_the_targets() -> None:
    found = {
        name: figures([time_upload(name, SEED, number) for number in range(30)])
        for name in ("upload", "burst5", "burst20")
    }
    assert all(one["failed"] == 0 for one in found.values())
    limits = {"upload": 1.0, "burst5": 2.5, "burst20": 3.5}
    assert all(float(found[name]["p99_s"] or 99.0) <= most for name, most in limits.items())
