"""Two banks and one header: staging never touches what is live, a commit is whole or not there."""

import hashlib
import random

import pytest

from trimtab.firmware_model.storage.flash import Flash, PowerCut
from trimtab.firmware_model.storage.store import MAGIC, ReferenceStore, memory_bytes
from trimtab.protocol.upload import SIGNED_CHUNK_BYTES

REF, FF = 1, 2


def test_store_new_holds_nothing():
    store = ReferenceStore()
    assert store.live(REF) is None
    assert store.staged(REF) is None
    with pytest.raises(ValueError, match="no blob is staged"):
        store.commit(REF)


def test_stage_then_commit_swaps_and_empties_the_staged_slot():
    store = ReferenceStore()
    assert store.stage(REF, b"one") == hashlib.sha256(b"one").hexdigest()
    assert (store.live(REF), store.staged(REF)) == (None, b"one")
    assert store.commit(REF) == b"one"
    assert (store.live(REF), store.staged(REF)) == (b"one", None)


def test_stage_again_leaves_the_live_blob_untouched_until_commit():
    store = ReferenceStore()
    store.stage(REF, b"one")
    store.commit(REF)
    store.stage(REF, b"two")
    assert (store.live(REF), store.staged(REF)) == (b"one", b"two")
    store.discard(REF)
    assert (store.live(REF), store.staged(REF)) == (b"one", None)
    store.stage(REF, b"three")
    store.commit(REF)
    assert store.live(REF) == b"three"


def test_commit_of_a_damaged_bank_is_refused_and_live_stays():
    store = ReferenceStore()
    store.stage(REF, b"one")
    store.commit(REF)
    store.stage(REF, b"two")
    where = store.flash.image.index(b"two")
    store.flash.program(where, b"twO")
    with pytest.raises(ValueError, match="damaged"):
        store.commit(REF)
    assert store.live(REF) == b"one"


def test_kinds_are_kept_apart():
    store = ReferenceStore()
    store.stage(REF, b"ref")
    store.stage(FF, b"ff")
    store.commit(FF)
    assert (store.live(REF), store.live(FF)) == (None, b"ff")
    store.clear(FF)
    assert store.live(FF) is None
    assert store.staged(REF) == b"ref"


@pytest.mark.parametrize("blob", [b"", bytes(17)])
def test_stage_of_a_blob_that_does_not_fit_is_refused(blob):
    with pytest.raises(ValueError, match="1 to 16 bytes"):
        ReferenceStore(blob_bytes_max=16).stage(REF, blob)


def again(store):
    """The store after a power cycle."""
    return ReferenceStore(Flash(bytearray(store.flash.image)), blob_bytes_max=store.blob_bytes_max)


def test_live_staged_and_gathered_survive_a_power_cycle():
    blob = random.Random(1).randbytes(1_000)
    store = ReferenceStore(blob_bytes_max=2_000)
    store.stage(REF, b"old")
    store.commit(REF)
    store.stage(REF, b"new")
    store.begin(FF, len(blob), hashlib.sha256(blob).digest())
    for index in (0, 3, 10):
        store.put(FF, index, blob[99 * index : 99 * (index + 1)])
    store = again(store)
    assert store.faults == []
    assert (store.live(REF), store.staged(REF), store.staged(FF)) == (b"old", b"new", None)
    incoming = store.incoming()
    assert incoming is not None
    assert incoming[:3] == (FF, len(blob), hashlib.sha256(blob).digest())
    assert [k for k, here in enumerate(incoming.held) if here] == [0, 3, 10]
    assert store.commit(REF) == b"new"
    assert again(store).live(REF) == b"new"


def test_chunk_that_no_longer_matches_its_mark_is_not_held():
    blob = random.Random(2).randbytes(300)
    store = ReferenceStore(blob_bytes_max=300)
    store.begin(REF, len(blob), hashlib.sha256(blob).digest())
    for index in range(4):
        store.put(REF, index, blob[99 * index : 99 * (index + 1)])
    store.flash.program(store.flash.image.index(blob[99:120]), bytes(1))
    incoming = again(store).incoming()
    assert incoming is not None
    assert list(incoming.held) == [1, 0, 1, 1]


def test_last_chunk_of_four_bytes_is_not_held_before_it_came():
    """Four erased bytes have the checksum of four erased bytes."""
    store = ReferenceStore(blob_bytes_max=300)
    store.begin(REF, 103, bytes(32))
    incoming = again(store).incoming()
    assert incoming is not None
    assert list(incoming.held) == [0, 0]


def test_live_blob_that_is_damaged_gives_way_to_the_one_before_it():
    store = ReferenceStore()
    for blob in (b"the first", b"the second"):
        store.stage(REF, blob)
        store.commit(REF)
    store.flash.program(store.flash.image.index(b"the second"), bytes(3))
    assert store.live(REF) == b"the first"
    after = again(store)
    assert after.live(REF) == b"the first"
    assert after.faults == ["memory: a reference is damaged"]
    after.stage(REF, b"the third")
    assert after.live(REF) == b"the first"
    after.commit(REF)
    assert again(after).live(REF) == b"the third"


@pytest.mark.parametrize("seed", range(5))
def test_memory_full_of_garbage_boots_with_nothing_live_and_says_so(seed):
    size = memory_bytes(1_000)
    store = ReferenceStore(Flash(bytearray(random.Random(seed).randbytes(size))), blob_bytes_max=1_000)
    assert store.faults == ["memory damaged and erased: nothing is live"]
    assert (store.live(REF), store.staged(REF), store.incoming()) == (None, None, None)
    store.stage(REF, b"one")
    store.commit(REF)
    assert again(store).live(REF) == b"one"
    assert again(store).faults == []


@pytest.mark.parametrize("seed", range(5))
def test_memory_of_garbage_behind_a_right_beginning_boots_with_nothing_live_and_says_so(seed):
    image = bytearray(random.Random(seed).randbytes(memory_bytes(1_000)))
    image[: len(MAGIC)] = MAGIC
    store = ReferenceStore(Flash(image), blob_bytes_max=1_000)
    assert len(store.faults) == 6  # four banks, the parameters and the signing key
    assert (store.live(REF), store.staged(REF), store.incoming()) == (None, None, None)
    store.stage(REF, b"one")
    store.commit(REF)
    assert again(store).live(REF) == b"one"


def test_log_of_a_bank_that_is_full_of_torn_commits_refuses_and_the_next_upload_mends_it():
    store = ReferenceStore(blob_bytes_max=300)
    store.stage(REF, b"old")
    store.commit(REF)
    store.stage(REF, b"new")
    for _ in range(62):
        store.flash.cut_after(20)
        with pytest.raises(PowerCut):
            store.commit(REF)
        store = again(store)
        assert (store.live(REF), store.staged(REF)) == (b"old", b"new")
    with pytest.raises(ValueError, match="full"):
        store.commit(REF)
    store.stage(REF, b"new")
    assert store.commit(REF) == b"new"


def test_clear_leaves_neither_the_live_blob_nor_the_one_before_it():
    store = ReferenceStore()
    for blob in (b"one", b"two"):
        store.stage(REF, blob)
        store.commit(REF)
    store.clear(REF)
    assert again(store).live(REF) is None


def test_memory_of_another_size_is_refused():
    with pytest.raises(ValueError, match="the memory needs"):
        ReferenceStore(Flash.blank(8192))


def test_upload_in_signed_chunks_is_resumed_with_its_chunk_size_after_a_power_cycle():
    flash = Flash.blank(memory_bytes(1_000))
    store = ReferenceStore(flash, blob_bytes_max=1_000)
    blob = bytes(range(250)) * 4
    store.begin(REF, len(blob), hashlib.sha256(blob).digest(), SIGNED_CHUNK_BYTES)
    chunks = [blob[k : k + SIGNED_CHUNK_BYTES] for k in range(0, len(blob), SIGNED_CHUNK_BYTES)]
    for index in (0, 2, 11):
        store.put(REF, index, chunks[index])
    again = ReferenceStore(Flash(bytearray(flash.image)), blob_bytes_max=1_000)
    incoming = again.incoming()
    assert incoming is not None
    assert incoming.chunk_bytes == SIGNED_CHUNK_BYTES
    assert [index for index, held in enumerate(incoming.held) if held] == [0, 2, 11]
    for index, chunk in enumerate(chunks):
        if not incoming.held[index]:
            again.put(REF, index, chunk)
    assert again.received(REF) == blob
