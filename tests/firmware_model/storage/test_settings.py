"""Parameters in memory: whole or as before, whatever becomes of a write."""

import random

import pytest

from trimtab.firmware_model.storage.flash import Flash, PowerCut
from trimtab.firmware_model.storage.settings import SETTINGS_BYTES, Settings

ID = bytes(range(6))


def again(flash):
    return Settings(Flash(bytearray(flash.image)), 0)


def test_new_memory_keeps_nothing_for_nobody():
    settings = Settings(Flash.blank(SETTINGS_BYTES), 0)
    assert (settings.vehicle_id, settings.values, settings.damaged) == (None, {}, False)


def test_change_is_there_after_a_power_cycle_and_the_same_again_writes_nothing():
    flash = Flash.blank(SETTINGS_BYTES)
    settings = Settings(flash, 0)
    settings.keep(ID, {})
    settings.change("POS_P_N", 5.5)
    settings.change("A_NAME_OF_SIXTEEN"[:16], -1.0)
    assert again(flash).values == {"POS_P_N": 5.5, "A_NAME_OF_SIXTEE": -1.0}
    assert again(flash).vehicle_id == ID
    written = flash.written
    settings.change("POS_P_N", 5.5)
    assert flash.written == written


def test_change_torn_at_any_byte_leaves_the_old_or_the_new_value():
    flash = Flash.blank(SETTINGS_BYTES)
    settings = Settings(flash, 0)
    settings.keep(ID, {"A": 1.0, "B": 2.0})
    image, before = bytes(flash.image), flash.written
    settings.change("A", 3.0)
    rng, seen = random.Random(6_001), set()
    tail = range(4_090, flash.written - before)  # the program that follows the erase, byte by byte
    for count in (*tail, *(rng.randrange(4_096) for _ in range(100))):
        torn = Flash(bytearray(image))
        torn.cut_after(count)
        with pytest.raises(PowerCut):
            Settings(torn, 0).change("A", 3.0)
        values = again(torn).values
        assert values in ({"A": 1.0, "B": 2.0}, {"A": 3.0, "B": 2.0})
        seen.add(values["A"])
    assert 1.0 in seen


def test_garbage_is_told_and_written_over():
    flash = Flash(bytearray(random.Random(3).randbytes(SETTINGS_BYTES)))
    settings = Settings(flash, 0)
    assert (settings.vehicle_id, settings.damaged) == (None, True)
    settings.keep(ID, {"A": 1.0})
    assert again(flash).values == {"A": 1.0}


def test_more_values_than_there_is_room_for_are_refused():
    with pytest.raises(ValueError, match="at most 204 parameters fit, not 205"):
        Settings(Flash.blank(SETTINGS_BYTES), 0).keep(ID, {f"P{k}": 0.0 for k in range(205)})
