"""Uploads through power cuts at any byte, restarts of either end and cuts of the link.

A thousand points each, drawn from seeds, on both state machines and the vehicle's memory in lock-step:
`make test` takes the first hundred of them, `make test-all` all. After
every fault the live blob is the old or the new one, whole, and the upload arrives. A chunk counts as sent
needlessly where it was in memory (bytes and mark) at the moment of the fault and the host sends it after it
got an answer that the vehicle gave after the fault: until then it cannot know what arrived of what was under
way. A host that follows one that was killed has nothing under way, and is held to every chunk from its first
message on. A chunk whose mark was torn is not in memory.
"""

from __future__ import annotations

import heapq
import random
from itertools import count

import pytest

from trimtab.firmware_model.storage.flash import SECTOR_BYTES, Flash, PowerCut
from trimtab.firmware_model.storage.settings import SETTINGS_BYTES
from trimtab.firmware_model.storage.store import ReferenceStore
from trimtab.protocol import messages as m
from trimtab.protocol.blobs import Kind
from trimtab.protocol.messages import Message
from trimtab.protocol.upload import SenderState, UploadReceiver, UploadSender, Verdict

REFERENCE = Kind.REFERENCE
BANK_BYTES = 8_192
SLOT_US = 2_000
POINTS = 1_000
BATCHES = 10
VEHICLE_ID = bytes(6)
OLD = b"the old one" * 30
BATCH_PARAMS = [pytest.param(batch, marks=pytest.mark.full if batch else ()) for batch in range(BATCHES)]


class RecordedFlash(Flash):
    """Flash that notes every write: bytes written before it, its place and size, whether it erases."""

    def __init__(self, image: bytearray) -> None:
        super().__init__(image)
        self.writes: list[tuple[int, int, int, bool]] = []

    def program(self, start: int, data: bytes) -> None:
        self.writes.append((self.written, start, len(data), False))
        super().program(start, data)

    def erase(self, start: int, size: int) -> None:
        for sector in range(start, start + size, SECTOR_BYTES):
            self.writes.append((self.written, sector, SECTOR_BYTES, True))
            super().erase(sector, SECTOR_BYTES)


def old_memory() -> bytes:
    """Memory with a live reference, one before it and a parameter."""
    store = ReferenceStore(blob_bytes_max=BANK_BYTES)
    for blob in (b"the one before", OLD):
        store.stage(REFERENCE, blob)
        store.commit(REFERENCE)
    store.settings.keep(VEHICLE_ID, {"A": 1.0})
    return bytes(store.flash.image)


MEMORY = old_memory()


class Upload:
    """One upload over a channel of one message a slot each way: 6 ms, up to 6 ms more, one in ten lost.

    Parameter A is set to 2 and 3 on the way. Everything comes from the seed.
    """

    def __init__(self, seed: int) -> None:
        self.rng = random.Random(seed)
        self.blob = self.rng.randbytes(self.rng.randint(1, BANK_BYTES))
        self.flash = RecordedFlash(bytearray(MEMORY))
        self.set_at_us = [self.rng.randrange(150_000) // SLOT_US * SLOT_US for _ in range(2)]
        self.values = iter((2.0, 3.0))
        self.wanted = 1.0
        self.now_us = 0
        self.number = count()
        self.up: list[tuple[int, int, Message]] = []
        self.down: list[tuple[int, int, Message]] = []
        self.up_queue: list[Message] = []
        self.down_queue: list[Message] = []
        self.link_cut_us: tuple[int, int] = (0, 0)
        self.asleep_until_us = 0
        self.in_memory: set[int] = set()
        self.answers_from = -1  # number of the first message that left the vehicle after the fault
        self.answered = False
        self.needless = 0
        self.start_host()
        self.start_vehicle()

    def start_host(self) -> None:
        self.sender = UploadSender(self.blob, REFERENCE)
        self.up_queue.clear()

    def start_vehicle(self) -> None:
        """Power is there, after whatever was: what is in memory is all there is."""
        self.flash = RecordedFlash(self.flash.image)
        self.store = ReferenceStore(self.flash, blob_bytes_max=BANK_BYTES)
        self.receiver = UploadReceiver(
            self.store,
            check=lambda kind, blob: Verdict(ok=blob == self.blob),
            may_commit=lambda kind: True,
            capacity=BANK_BYTES,
        )
        self.down_queue.clear()

    def fault(self) -> None:
        """From now on chunks that come again are counted."""
        found = ReferenceStore(Flash(bytearray(self.flash.image)), blob_bytes_max=BANK_BYTES)
        incoming = found.incoming()
        self.in_memory = set()
        if incoming is not None and incoming.digest == self.sender.digest:
            self.in_memory = {k for k, here in enumerate(incoming.held) if here}
        self.answers_from, self.answered = next(self.number), False
        self.needless = 0

    def power_cycle(self, off_us: int) -> None:
        """Off now and on after a while; what was on its way to the vehicle meanwhile is lost."""
        self.fault()
        self.start_vehicle()
        assert self.live_is_whole()
        self.asleep_until_us = self.now_us + off_us

    def live_is_whole(self) -> bool:
        live = ReferenceStore(Flash(bytearray(self.flash.image)), blob_bytes_max=BANK_BYTES).live(REFERENCE)
        return live in (OLD, self.blob)

    def slot(self) -> None:
        now = self.now_us = self.now_us + SLOT_US
        self.host(now)
        if now >= self.asleep_until_us:
            self.vehicle(now)
        else:
            self.up = [frame for frame in self.up if frame[0] > now]

    def host(self, now: int) -> None:
        while self.down and self.down[0][0] <= now:
            _, number, message = heapq.heappop(self.down)
            self.answered |= 0 <= self.answers_from < number
            self.sender.receive(message, now)
        self.sender.advance(now)
        for message in self.sender.send(now):
            if isinstance(message, m.UploadChunk) and self.answered:
                self.needless += message.index in self.in_memory
            self.up_queue.append(message)
        if self.up_queue:
            self.send(self.up, self.up_queue.pop(0), now)

    def vehicle(self, now: int) -> None:
        while self.up and self.up[0][0] <= now:
            self.receiver.receive(heapq.heappop(self.up)[2], now)
        if now in self.set_at_us:
            self.wanted = next(self.values)
            self.store.settings.change("A", self.wanted)
        self.receiver.advance(now)
        self.down_queue += self.receiver.send(now)
        if self.down_queue:
            self.send(self.down, self.down_queue.pop(0), now)

    def send(self, way: list[tuple[int, int, Message]], message: Message, now: int) -> None:
        lost = self.rng.random() < 0.1 or self.link_cut_us[0] <= now < self.link_cut_us[1]
        if not lost:
            heapq.heappush(way, (now + 6_000 + self.rng.randrange(6_001), next(self.number), message))

    def run(self, until_us: int = 60_000_000) -> None:
        while not self.sender.over and self.now_us < until_us:
            self.slot()

    def run_past_settings(self) -> None:
        """To its end, and until both parameters are set."""
        self.run()
        while self.now_us < max(self.set_at_us):
            self.slot()

    def finish(self) -> None:
        """To its end: the blob is live, and nothing was sent that was there."""
        self.run()
        assert self.sender.state is SenderState.DONE, self.sender.reason
        assert self.store.live(REFERENCE) == self.blob
        assert self.live_is_whole()
        assert self.needless == 0


def clean_run(seed: int) -> Upload:
    upload = Upload(seed)
    upload.run_past_settings()
    assert upload.sender.state is SenderState.DONE
    return upload


def sort_of(write: tuple[int, int, int, bool]) -> str:
    """What a write is about: an erasure, parameters, a record, a chunk or its mark."""
    _, start, size, erases = write
    if start < SECTOR_BYTES + SETTINGS_BYTES:
        return "parameters"
    return "erase" if erases else {48: "record", 4: "mark"}.get(size, "chunk")


@pytest.mark.parametrize("batch", BATCH_PARAMS)
def test_power_cut_at_any_byte_leaves_the_old_or_the_new_and_the_upload_goes_on(batch: int) -> None:
    torn: dict[str, int] = dict.fromkeys(("erase", "parameters", "record", "chunk", "mark"), 0)
    saved = 0
    for run in range(5):
        seed = 61_000 + 5 * batch + run
        writes = clean_run(seed).flash.writes
        rng = random.Random(f"cut {seed}")
        for _ in range(POINTS // BATCHES // 5):
            sort = rng.choice(sorted({sort_of(write) for write in writes}))
            before, _, size, _ = rng.choice([write for write in writes if sort_of(write) == sort])
            upload = Upload(seed)
            upload.flash.cut_after(before + rng.randrange(size))
            with pytest.raises(PowerCut):
                upload.run_past_settings()
            upload.power_cycle(rng.randrange(1_000_000))
            known = {upload.wanted} if sort != "parameters" else {upload.wanted, upload.wanted - 1.0}
            assert upload.store.settings.values["A"] in known
            saved += len(upload.in_memory)
            torn[sort] += 1
            upload.finish()
            assert upload.sender.restarts == 0
    assert sum(torn.values()) == POINTS // BATCHES
    assert min(torn.values()) > 5
    assert saved > 0


def random_point(seed: int, end_us: int) -> tuple[Upload, random.Random]:
    """An upload at a random moment between its first slot and `end_us`, the end of its clean run."""
    rng = random.Random(f"point {seed}")
    upload = Upload(seed)
    upload.run(rng.randrange(end_us))
    return upload, rng


def vehicle_reset(upload: Upload, rng: random.Random) -> None:
    upload.power_cycle(rng.randrange(1_000_000))
    assert upload.store.settings.values["A"] == upload.wanted


def host_killed(upload: Upload, rng: random.Random) -> None:
    """The next one begins at once, while what the vehicle said to the old one is still in the air."""
    upload.fault()
    upload.answered = True
    upload.start_host()


def link_cut(upload: Upload, rng: random.Random) -> None:
    upload.fault()
    upload.link_cut_us = (upload.now_us, upload.now_us + 5_000_000)


@pytest.mark.parametrize("batch", BATCH_PARAMS)
def test_upload_goes_on_after_a_fault_at_any_moment(batch: int) -> None:
    faults = (vehicle_reset, host_killed, link_cut)
    saved = dict.fromkeys(faults, 0)
    for seed in range(62_000 + 100 * batch, 62_000 + 100 * batch + POINTS // BATCHES):
        end_us = clean_run(seed).now_us
        for happens in faults:
            upload, rng = random_point(seed, end_us)
            happens(upload, rng)
            saved[happens] += len(upload.in_memory)
            upload.finish()
            assert upload.sender.restarts == 0, f"{happens.__name__}, seed {seed}"
    assert min(saved.values()) > 0, saved


def test_needless_chunks_are_counted() -> None:
    """A vehicle that lost its memory without saying so would be found out."""
    upload, _ = random_point(62_007, clean_run(62_007).now_us)
    upload.fault()
    upload.in_memory = set(range(upload.sender.chunks))
    upload.start_host()
    upload.run()
    assert upload.needless > 0
