"""Two banks and one header: staging never touches what is live, a commit is whole or not there."""

import hashlib

import pytest

from firmware_model.store import ReferenceStore

REF, FF = 1, 2


def test_store_new_holds_nothing():
    store = ReferenceStore()
    assert store.live(REF) is None
    assert store.staged(REF) is None
    with pytest.raises(ValueError, match="nothing is staged"):
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
    store._banks[REF, 1] = b"twO"
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
        ReferenceStore(bank_bytes=16).stage(REF, blob)
