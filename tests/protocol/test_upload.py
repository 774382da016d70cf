"""The two ends of an upload over a channel that loses, delays, repeats and garbles."""

from __future__ import annotations

import hashlib
import heapq
import random
from dataclasses import dataclass, field

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from trimtab.protocol import messages as m
from trimtab.protocol.blobs import Kind
from trimtab.protocol.codec import Codec
from trimtab.protocol.messages import Message, UploadResult, UploadState
from trimtab.protocol.upload import (
    CHUNK_BYTES,
    SIGNED_CHUNK_BYTES,
    Incoming,
    ReceiverEvent,
    SenderState,
    UploadEvent,
    UploadReceiver,
    UploadSender,
    Verdict,
)
from trimtab.protocol.upload.transfer import chunk_count

REFERENCE = Kind.REFERENCE


class Store:
    """Live and staged blobs, as the vehicle's."""

    def __init__(self) -> None:
        self.lives: dict[int, bytes] = {}
        self.stages: dict[int, bytes] = {}
        self.begun: Incoming | None = None
        self.data = bytearray()

    def live(self, kind: int) -> bytes | None:
        return self.lives.get(kind)

    def incoming(self) -> Incoming | None:
        return self.begun

    def begin(self, kind: int, size: int, digest: bytes, chunk_bytes: int) -> None:
        held = bytearray(chunk_count(size, chunk_bytes))
        self.begun = Incoming(kind, size, digest, chunk_bytes, held)
        self.data = bytearray(size)

    def put(self, kind: int, index: int, chunk: bytes) -> None:
        assert self.begun is not None
        assert self.begun.kind == kind
        start = index * self.begun.chunk_bytes
        self.data[start : start + len(chunk)] = chunk
        self.begun.held[index] = 1

    def received(self, kind: int) -> bytes:
        return bytes(self.data)

    def stage(self, kind: int, blob: bytes) -> None:
        self.stages[kind] = blob

    def commit(self, kind: int) -> None:
        self.lives[kind] = self.stages.pop(kind)
        self.begun = None

    def discard(self, kind: int) -> None:
        self.stages.pop(kind, None)
        if self.begun is not None and self.begun.kind == kind:
            self.begun = None


def accept(kind: int, blob: bytes) -> Verdict:
    return Verdict(ok=True)


def make_receiver(store: Store, check=accept, *, may_commit: bool = True, **options) -> UploadReceiver:
    return UploadReceiver(store, check=check, may_commit=lambda kind: may_commit, capacity=100_000, **options)


def make_blob(size: int, seed: int = 0) -> bytes:
    return random.Random(seed).randbytes(size)


@dataclass
class Channel:
    """One direction: loss in bursts of slots, latency, jitter, duplicates, bit errors, a cut."""

    rng: random.Random
    loss: float = 0.0
    burst: float = 5.0
    jitter_us: int = 4_000
    duplicates: float = 0.0
    garble: float = 0.0
    cut_us: tuple[int, int] = (0, 0)
    bad: bool = False
    sent: int = 0
    frames: list[tuple[int, int, bytes]] = field(default_factory=list)

    def slot(self) -> None:
        leave = 1.0 / self.burst
        enter = leave * self.loss / (1.0 - self.loss)
        self.bad = self.rng.random() < (1.0 - leave if self.bad else enter)

    def send(self, data: bytes, now_us: int) -> None:
        self.sent += 1
        if self.bad or self.cut_us[0] <= now_us < self.cut_us[1]:
            return
        if self.rng.random() < self.garble:
            damaged = bytearray(data)
            damaged[self.rng.randrange(len(data))] ^= 1 << self.rng.randrange(8)
            data = bytes(damaged)
        for _ in range(2 if self.rng.random() < self.duplicates else 1):
            arrival = now_us + 6_000 + self.rng.randrange(self.jitter_us + 1)
            heapq.heappush(self.frames, (arrival, self.sent, data))

    def arrived(self, now_us: int) -> list[bytes]:
        found = []
        while self.frames and self.frames[0][0] <= now_us:
            found.append(heapq.heappop(self.frames)[2])
        return found


class Link:
    """Sender, receiver and the channels between them, in slots of 2 ms with one message a slot each way."""

    def __init__(self, sender: UploadSender, receiver: UploadReceiver, up: Channel, down: Channel) -> None:
        self.sender, self.receiver, self.up, self.down = sender, receiver, up, down
        self.host, self.vehicle = Codec(*m.HOST), Codec(*m.VEHICLE)
        self.up_queue: list[bytes] = []
        self.down_queue: list[bytes] = []
        self.events: list[UploadEvent] = []
        self.now_us = 0

    def slot(self) -> None:
        now = self.now_us = self.now_us + 2_000
        self.up.slot()
        self.down.slot()
        self.sender.advance(now)
        self.up_queue += [self.host.encode(message) for message in self.sender.send(now)]
        if self.up_queue:
            self.up.send(self.up_queue.pop(0), now)
        for data in self.up.arrived(now):
            for message in self.vehicle.decode(data):
                self.events += [e.event for e in self.receiver.receive(message, now)]
        self.events += [e.event for e in self.receiver.advance(now)]
        self.down_queue += [self.vehicle.encode(message) for message in self.receiver.send(now)]
        if self.down_queue:
            self.down.send(self.down_queue.pop(0), now)
        for data in self.down.arrived(now):
            for message in self.host.decode(data):
                self.sender.receive(message, now)

    def run(self, seconds: float = 60.0) -> None:
        stop = self.now_us + round(seconds * 1e6)
        while not self.sender.over and self.now_us < stop:
            self.slot()


def make_link(
    blob: bytes, store: Store, seed: int = 0, check=accept, patience_us: int = 15_000_000, **channel
) -> Link:
    sender = UploadSender(blob, REFERENCE, patience_us=patience_us)
    up, down = (Channel(random.Random(2 * seed + k), **channel) for k in range(2))
    return Link(sender, make_receiver(store, check), up, down)


@pytest.mark.parametrize(("loss", "burst"), [(0.0, 5.0), (0.1, 5.0), (0.1, 20.0), (0.3, 5.0), (0.3, 20.0)])
def test_upload_over_loss_in_bursts_arrives_byte_exact(loss: float, burst: float) -> None:
    blob = make_blob(20_800)
    for seed in range(3):
        store = Store()
        link = make_link(blob, store, seed, loss=loss, burst=burst, duplicates=0.05, garble=0.01)
        link.run()
        assert link.sender.state is SenderState.DONE, link.sender.reason
        assert store.lives == {REFERENCE: blob}
        assert store.stages == {}


def test_upload_in_chunks_of_another_size_begins_again_and_arrives_byte_exact() -> None:
    blob, store = make_blob(20_800), Store()
    link = make_link(blob, store)
    while link.sender.held < 50:
        link.slot()
    link.sender = UploadSender(blob, REFERENCE, chunk_bytes=SIGNED_CHUNK_BYTES)
    link.run()
    assert link.sender.state is SenderState.DONE, link.sender.reason
    assert store.lives == {REFERENCE: blob}
    assert link.sender.chunks == chunk_count(len(blob), SIGNED_CHUNK_BYTES) == 242
    assert link.sender.restarts == 0


def test_staged_blob_is_committed_whatever_the_size_of_its_chunks_was() -> None:
    blob, store = make_blob(20_800), Store()
    receiver = make_receiver(store)
    up, down = (Channel(random.Random(k)) for k in range(2))
    link = Link(UploadSender(blob, REFERENCE, commit=False), receiver, up, down)
    link.run()
    link.sender = UploadSender(blob, REFERENCE, chunk_bytes=SIGNED_CHUNK_BYTES)
    link.run()
    assert link.sender.state is SenderState.DONE
    assert link.sender.chunks_sent == 0
    assert store.lives == {REFERENCE: blob}


def test_chunk_size_that_the_vehicle_does_not_accept_is_refused() -> None:
    with pytest.raises(ValueError, match="chunk_bytes must be one of"):
        UploadSender(b"blob", REFERENCE, chunk_bytes=50)


def test_upload_without_loss_sends_every_chunk_once() -> None:
    blob = make_blob(20_800)
    link = make_link(blob, Store(), jitter_us=0)
    link.run()
    assert link.sender.chunks_repeated == 0
    assert link.sender.chunks_sent == 211


def test_upload_that_takes_longer_than_its_patience_goes_on_while_chunks_arrive() -> None:
    store, blob = Store(), make_blob(20_800)
    link = make_link(blob, store, jitter_us=0, patience_us=200_000)
    link.run()
    assert link.now_us > 400_000
    assert link.sender.state is SenderState.DONE, link.sender.reason
    assert store.lives == {REFERENCE: blob}


def test_upload_at_ten_percent_loss_repeats_little_more_than_was_lost() -> None:
    repeated = 0
    for seed in range(5):
        link = make_link(make_blob(20_800), Store(), seed, loss=0.1)
        link.run()
        repeated += link.sender.chunks_repeated
    assert repeated < 5 * 211 * 0.25


@settings(max_examples=25)
@given(
    size=st.integers(1, 3_000),
    loss=st.sampled_from([0.0, 0.1, 0.3, 0.5]),
    burst=st.sampled_from([2.0, 5.0, 20.0]),
    duplicates=st.sampled_from([0.0, 0.3]),
    garble=st.sampled_from([0.0, 0.1]),
    jitter_us=st.sampled_from([0, 4_000, 40_000]),
    seed=st.integers(0, 2**32),
)
def test_upload_over_any_channel_is_exact_or_fails_with_nothing_live(
    size, loss, burst, duplicates, garble, jitter_us, seed
) -> None:
    blob, store = make_blob(size, seed), Store()
    store.lives[REFERENCE] = b"old"
    link = make_link(
        blob, store, seed, loss=loss, burst=burst, duplicates=duplicates, garble=garble, jitter_us=jitter_us
    )
    while not link.sender.over:
        link.slot()
        if UploadEvent.COMMITTED not in link.events:
            assert store.lives == {REFERENCE: b"old"}
    assert link.sender.state is SenderState.DONE, link.sender.reason
    assert store.lives == {REFERENCE: blob}
    assert link.receiver.live_id(REFERENCE).hex() == link.sender.id


def test_upload_through_a_cut_resumes_where_it_was() -> None:
    blob, store = make_blob(20_800), Store()
    link = make_link(blob, store, cut_us=(200_000, 8_200_000))
    link.run()
    assert store.lives == {REFERENCE: blob}
    assert link.events.count(UploadEvent.BEGAN) == 1
    assert link.sender.chunks_repeated < 80  # what was under way at the cut, not what had arrived


def test_upload_whose_receiver_restarts_midway_goes_on_where_it_was() -> None:
    blob, store = make_blob(20_800), Store()
    link = make_link(blob, store, loss=0.1, duplicates=0.2)
    link.run(0.2)
    assert 0 < link.receiver.held < link.receiver.chunks
    link.receiver = make_receiver(store)
    assert link.receiver.held > 40
    link.run()
    assert store.lives == {REFERENCE: blob}
    assert link.sender.state is SenderState.DONE
    assert link.sender.restarts == 0


def test_upload_whose_receiver_restarts_with_its_memory_lost_starts_again_and_arrives() -> None:
    blob, store = make_blob(20_800), Store()
    link = make_link(blob, store, loss=0.1, duplicates=0.2)
    link.run(0.2)
    store.begun = None
    link.receiver = make_receiver(store)
    assert link.receiver.state is UploadState.IDLE
    link.run()
    assert store.lives == {REFERENCE: blob}
    assert link.sender.state is SenderState.DONE
    assert link.sender.restarts > 0


def test_upload_whose_receiver_restarts_behind_a_late_begin_still_arrives() -> None:
    """A delayed announcement sets the new receiver going before it can say that it knows nothing."""
    blob, store = make_blob(20_800), Store()
    link = make_link(blob, store)
    link.run(0.2)
    store.begun = None
    link.receiver = make_receiver(store)
    link.receiver.receive(
        m.UploadBegin(len(blob), 1, REFERENCE, CHUNK_BYTES, 1, link.sender.digest), link.now_us
    )
    link.run()
    assert store.lives == {REFERENCE: blob}


def test_upload_of_another_blob_midway_takes_over() -> None:
    first, second, store = make_blob(20_800, 1), make_blob(9_000, 2), Store()
    link = make_link(first, store)
    link.run(0.2)
    link.sender = UploadSender(second, REFERENCE)
    link.run()
    assert store.lives == {REFERENCE: second}
    assert UploadEvent.DISCARDED in link.events


def test_upload_over_a_dead_link_fails_without_progress_and_says_so() -> None:
    link = make_link(make_blob(5_000), Store(), cut_us=(100_000, 10**12), patience_us=3_000_000)
    link.run()
    assert link.sender.state is SenderState.FAILED
    assert link.sender.silent
    assert "no progress for 3 s" in link.sender.reason


def test_receiver_whose_sender_is_gone_falls_silent_and_keeps_what_it_gathered() -> None:
    store = Store()
    link = make_link(make_blob(5_000), store, cut_us=(100_000, 10**12), patience_us=1_000_000)
    link.run()
    held = link.receiver.held
    while (deadline := link.receiver.next_deadline_us()) is not None:
        assert deadline < 31_000_000
        assert link.receiver.advance(deadline) == []
        link.receiver.send(deadline)
    assert link.receiver.state is UploadState.RECEIVING
    assert link.receiver.held == held > 0


def test_receiver_holding_a_staged_blob_that_nobody_commits_keeps_it() -> None:
    blob, store = make_blob(500), Store()
    link = make_link(blob, store)
    link.sender = UploadSender(blob, REFERENCE, commit=False)
    link.run()
    assert link.sender.state is SenderState.DONE
    link.receiver.advance(link.now_us + 300_000_000)
    assert store.stages == {REFERENCE: blob}
    assert store.lives == {}


def test_upload_that_was_refused_is_checked_again_when_it_is_announced_again() -> None:
    blob, store, verdict = make_blob(500), Store(), [Verdict(ok=False, message="too fast")]
    link = make_link(blob, store, check=lambda kind, data: verdict[0])
    link.run()
    assert link.sender.state is SenderState.FAILED
    verdict[0] = Verdict(ok=True)  # a limit was changed
    link.sender = UploadSender(blob, REFERENCE)
    link.run()
    assert store.lives == {REFERENCE: blob}
    assert link.sender.chunks_sent == 0


def test_upload_that_the_check_refuses_names_node_and_reason_and_leaves_the_live_one() -> None:
    def refuse(kind: int, blob: bytes) -> Verdict:
        return Verdict(ok=False, node=17, reason=3, value=9.5, bound=8.0, message="speed 9.5 m/s over 8")

    for loss in (0.0, 0.3):
        store = Store()
        store.lives[REFERENCE] = b"old"
        link = make_link(make_blob(5_000), store, check=refuse, loss=loss)
        link.run()
        assert link.sender.state is SenderState.FAILED
        assert link.sender.reason == "refused on board at node 17: speed 9.5 m/s over 8"
        assert link.sender.verdict == refuse(0, b"")
        assert store.lives == {REFERENCE: b"old"}
        assert store.stages == {}


def test_upload_corrupted_behind_the_checksum_is_refused_by_digest_and_sent_again() -> None:
    blob, store = make_blob(5_000), Store()
    link = make_link(blob, store)
    deceive = [True]
    receive = link.receiver.receive

    def receive_garbled(message: Message, now_us: int) -> list[ReceiverEvent]:
        if isinstance(message, m.UploadChunk) and message.index == 7 and deceive:
            deceive.pop()
            message.data = bytes(CHUNK_BYTES)
        return receive(message, now_us)

    link.receiver.receive = receive_garbled
    link.run()
    assert link.events.count(UploadEvent.CORRUPT) == 1
    assert link.sender.restarts >= 1
    assert store.lives == {REFERENCE: blob}


def test_upload_always_corrupted_fails_and_nothing_goes_live() -> None:
    store = Store()
    link = make_link(make_blob(5_000), store)
    link.sender.digest = hashlib.sha256(b"something else").digest()
    link.sender._tag = int.from_bytes(link.sender.digest[:2], "little")
    link.run()
    assert link.sender.state is SenderState.FAILED
    assert store.lives == {}
    assert store.stages == {}


def test_upload_of_what_is_live_already_sends_no_chunk() -> None:
    blob, store = make_blob(5_000), Store()
    store.lives[REFERENCE] = blob
    link = make_link(blob, store)
    link.run()
    assert link.sender.state is SenderState.DONE
    assert link.sender.chunks_sent == 0


def test_upload_too_large_is_rejected_at_once() -> None:
    link = make_link(make_blob(100_001), Store())
    link.run()
    assert link.sender.reason == "the vehicle has no room for 100001 bytes"


def test_upload_of_unknown_kind_or_chunk_size_is_rejected() -> None:
    receiver = make_receiver(Store())
    digest = bytes(range(32))
    for kind, chunk, size, result in (
        (9, CHUNK_BYTES, 10, UploadResult.BAD_KIND),
        (1, 50, 10, UploadResult.BAD_REQUEST),
        (1, CHUNK_BYTES, 0, UploadResult.BAD_REQUEST),
    ):
        assert receiver.receive(m.UploadBegin(size, 1, kind, chunk, 1, digest), 0) == []
        (status,) = receiver.send(0)
        assert isinstance(status, m.UploadStatus)
        assert (status.state, status.result) == (UploadState.IDLE, result)
        assert receiver.state is UploadState.IDLE


def test_answer_to_a_former_host_is_not_taken_for_the_own_one() -> None:
    receiver = make_receiver(Store())
    blob = make_blob(500)
    former, sender = UploadSender(blob, REFERENCE), UploadSender(blob, REFERENCE)
    receiver.receive(former.send(0)[0], 0)
    (stale,) = receiver.send(0)
    (question,) = sender.send(20_000)
    assert sender.receive(stale, 20_000)
    assert sender.state is SenderState.OPENING
    sender.advance(30_000)
    (again,) = sender.send(30_000)
    assert isinstance(stale, m.UploadStatus)
    assert isinstance(question, m.UploadBegin)
    assert isinstance(again, m.UploadBegin)
    assert again.query == question.query != stale.query
    receiver.receive(question, 30_000)
    (answer,) = receiver.send(30_000)
    sender.receive(answer, 40_000)
    assert sender.state is SenderState.SENDING


def test_late_copy_of_a_chunk_of_what_is_live_is_not_answered() -> None:
    blob, store = make_blob(500), Store()
    link = make_link(blob, store)
    link.run()
    tag = link.sender.digest[0] | link.sender.digest[1] << 8
    link.receiver.receive(m.UploadChunk(tag, 0, 1, blob[:99]), link.now_us)
    assert link.receiver.send(link.now_us + 1_000_000) == []
    link.receiver.receive(m.UploadChunk(tag ^ 1, 0, 1, blob[:99]), link.now_us)
    (status,) = link.receiver.send(link.now_us + 2_000_000)
    assert isinstance(status, m.UploadStatus)
    assert status.result == UploadResult.UNKNOWN


def test_commit_while_flying_is_refused_as_busy() -> None:
    store = Store()
    link = make_link(make_blob(500), store)
    link.receiver = make_receiver(store, may_commit=False)
    link.run()
    assert link.sender.state is SenderState.FAILED
    assert "only at an agreed tick" in link.sender.reason
    assert store.lives == {}


def test_commit_by_id_of_a_staged_blob_makes_it_live() -> None:
    blob, store = make_blob(500), Store()
    link = make_link(blob, store)
    link.sender = UploadSender(blob, REFERENCE, commit=False)
    link.run()
    kind, id_bytes = link.receiver.staged()
    assert kind == REFERENCE
    assert id_bytes.hex() == link.sender.id
    assert link.receiver.commit(bytes(6), link.now_us)[0] is UploadResult.UNKNOWN
    result, events = link.receiver.commit(id_bytes, link.now_us)
    assert result is UploadResult.OK
    assert [event.event for event in events] == [UploadEvent.COMMITTED]
    assert store.lives == {REFERENCE: blob}
    assert link.receiver.commit(id_bytes, link.now_us) == (UploadResult.OK, [])


def test_cancel_midway_makes_the_receiver_discard() -> None:
    link = make_link(make_blob(20_800), Store())
    link.run(0.2)
    link.sender.cancel(link.now_us)
    for _ in range(100):
        link.slot()
    assert link.sender.reason == "cancelled"
    assert link.receiver.state is UploadState.IDLE


@settings(max_examples=50)
@given(data=st.data())
def test_receiver_given_arbitrary_messages_never_raises_and_commits_only_what_matches(
    data: st.DataObject,
) -> None:
    store = Store()
    store.lives[REFERENCE] = b"old"
    receiver = make_receiver(store)
    blobs = [make_blob(150, 1), make_blob(250, 2)]
    digests = [hashlib.sha256(blob).digest() for blob in blobs]
    tags = [digest[0] | digest[1] << 8 for digest in digests]
    for now_us in range(0, 400_000, 10_000):
        which = data.draw(st.integers(0, 1))
        message = data.draw(
            st.sampled_from(
                [
                    m.UploadBegin(len(blobs[which]), 1, REFERENCE, CHUNK_BYTES, 1, digests[which]),
                    m.UploadCommit(m.NO_TICK, 1, REFERENCE, digests[which]),
                    m.UploadAbort(1, digests[which]),
                    *(
                        m.UploadChunk(tags[which], k, 1, blobs[which][99 * k : 99 * (k + 1)].ljust(99, b"\0"))
                        for k in range(3)
                    ),
                ]
            )
        )
        receiver.receive(message, now_us)
        receiver.advance(now_us)
        receiver.send(now_us)
        assert store.lives[REFERENCE] in (b"old", *blobs)
        assert set(store.stages.values()) <= set(blobs)
