"""Signing key in memory: used timestamps stay used, and no former key returns after a torn write."""

import random

import pytest

from trimtab.firmware_model.storage.flash import SECTOR_BYTES, Flash, PowerCut
from trimtab.firmware_model.storage.signing_store import SIGNING_BYTES, STEP, SigningStore
from trimtab.protocol.signing import SigningKey

ONE, TWO = SigningKey(bytes(range(32))), SigningKey(bytes(range(100, 132)))
NOW = 38_000_000_000_000


def again(flash):
    return SigningStore(Flash(bytearray(flash.image)), 0)


def stored(key=ONE, used=NOW):
    flash = Flash.blank(SIGNING_BYTES)
    store = SigningStore(flash, 0)
    store.keep(key, used)
    return flash, store


def test_new_memory_holds_no_key_and_stores_no_timestamps():
    flash = Flash.blank(SIGNING_BYTES)
    store = SigningStore(flash, 0)
    store.reserve(NOW)
    assert (store.key, store.used, store.damaged, flash.written) == (None, 0, False, 0)


def test_key_and_used_timestamps_outlive_a_power_cycle():
    flash, store = stored()
    assert (again(flash).key, again(flash).used) == (ONE, NOW)
    store.reserve(NOW + 1)
    assert again(flash).used == store.used == NOW + 1 + STEP


def test_memory_is_written_once_a_minute_of_signed_messages():
    flash, store = stored()
    before = flash.written
    for timestamp in range(NOW, NOW + 10 * STEP, STEP // 100):
        store.reserve(timestamp)
    assert flash.written - before <= 11 * 12


def test_two_hours_of_flight_after_power_up_erase_no_sector():
    flash, store = stored()
    for start in range(5):
        flash = Flash(bytearray(flash.image))
        store = SigningStore(flash, 0)
        before = flash.written
        for minute in range(1, 121):
            store.reserve(store.used + 1)
            assert flash.written - before < SECTOR_BYTES, (start, minute)


def test_full_log_moves_to_the_other_sector_and_loses_nothing():
    flash, store = stored()
    for _ in range(1000):
        store.reserve(store.used + 1)
        assert again(flash).used >= store.used
        assert again(flash).key == ONE


def test_replaced_key_is_nowhere_in_memory():
    flash, store = stored()
    store.keep(TWO, 5)
    assert (again(flash).key, again(flash).used) == (TWO, 5)
    assert ONE.secret not in bytes(flash.image)


def test_removed_key_is_nowhere_in_memory():
    flash, store = stored()
    store.forget()
    assert (store.key, store.used) == (None, 0)
    assert again(flash).key is None
    assert not again(flash).damaged
    assert ONE.secret not in bytes(flash.image)


def cuts(act):
    """The store after a power cut at each of many bytes of an action."""
    flash, store = stored()
    store.reserve(NOW + 1)
    image, before, used = bytes(flash.image), flash.written, store.used
    act(store)
    total = flash.written - before
    points = {*range(min(total, 20)), *range(SECTOR_BYTES - 10, min(total, SECTOR_BYTES + 80))}
    points |= {random.Random(4).randrange(total) for _ in range(50)}
    for count in sorted(points):
        torn = Flash(bytearray(image))
        torn.cut_after(count)
        with pytest.raises(PowerCut):
            act(SigningStore(torn, 0))
        yield again(torn), used


def test_torn_timestamp_never_makes_a_used_one_valid_again():
    for store, used in cuts(lambda store: store.reserve(store.used + 1)):
        assert store.key == ONE
        assert store.used >= used
        store.reserve(store.used + 1)


def test_entry_after_a_torn_one_counts():
    flash, store = stored()
    flash.cut_after(7)
    with pytest.raises(PowerCut):
        store.reserve(NOW + 1)
    flash = Flash(bytearray(flash.image))
    SigningStore(flash, 0).reserve(NOW + 9)
    assert again(flash).used == NOW + 9 + STEP


def test_torn_replacement_leaves_the_old_or_the_new_key():
    seen = set()
    for store, used in cuts(lambda store: store.keep(TWO, 5)):
        assert (store.key, store.used) in ((ONE, used), (TWO, 5))
        assert store.key is not None
        seen.add(store.key.secret)
        if store.key == TWO:
            assert ONE.secret not in bytes(store._flash.image)
    assert len(seen) == 2


def test_torn_removal_leaves_the_key_or_none():
    assert {store.key and store.key.secret for store, _ in cuts(lambda store: store.forget())} <= {
        None,
        ONE.secret,
    }


def test_garbage_is_told_and_written_over():
    flash = Flash(bytearray(random.Random(3).randbytes(SIGNING_BYTES)))
    store = SigningStore(flash, 0)
    assert (store.key, store.damaged) == (None, True)
    store.keep(ONE, 3)
    assert (again(flash).key, again(flash).damaged) == (ONE, False)
