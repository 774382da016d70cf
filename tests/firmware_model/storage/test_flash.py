"""Flash clears bits, erases whole sectors, and is torn where power fails."""

import os

import pytest

from trimtab.firmware_model.storage.flash import SECTOR_BYTES, Flash, PowerCut


def test_program_clears_bits_and_never_sets_them():
    flash = Flash.blank(SECTOR_BYTES)
    flash.program(10, bytes((0b1100_1111, 0x00)))
    flash.program(10, bytes((0b1111_0101, 0xFF)))
    assert flash.read(9, 4) == bytes((0xFF, 0b1100_0101, 0x00, 0xFF))


def test_erase_sets_whole_sectors_and_no_other():
    flash = Flash(bytearray(3 * SECTOR_BYTES))
    flash.erase(SECTOR_BYTES, 1)
    assert flash.blank_at(SECTOR_BYTES, SECTOR_BYTES)
    assert flash.read(0, SECTOR_BYTES) == flash.read(2 * SECTOR_BYTES, SECTOR_BYTES) == bytes(SECTOR_BYTES)


def test_program_torn_leaves_what_was_written_and_half_a_byte():
    flash = Flash.blank(SECTOR_BYTES)
    flash.cut_after(2)
    with pytest.raises(PowerCut):
        flash.program(0, bytes(4))
    assert flash.read(0, 4) == bytes((0x00, 0x00, 0xF0, 0xFF))
    with pytest.raises(PowerCut):
        flash.erase(0, 1)  # it stays off
    assert flash.read(0, 1) == b"\0"


def test_erase_torn_leaves_the_rest_as_it_was():
    flash = Flash(bytearray(2 * SECTOR_BYTES))
    flash.cut_after(SECTOR_BYTES + 7)
    with pytest.raises(PowerCut):
        flash.erase(0, 2 * SECTOR_BYTES)
    assert flash.blank_at(0, SECTOR_BYTES + 7)
    assert flash.read(SECTOR_BYTES + 7, 3) == bytes(3)


@pytest.mark.parametrize("size", [0, SECTOR_BYTES - 1])
def test_flash_of_part_of_a_sector_is_refused(size):
    with pytest.raises(ValueError, match="whole sectors"):
        Flash(bytearray(size))


def test_writes_beyond_the_end_or_off_a_sector_are_refused():
    flash = Flash.blank(SECTOR_BYTES)
    with pytest.raises(ValueError, match="beyond"):
        flash.program(SECTOR_BYTES - 1, b"ab")
    with pytest.raises(ValueError, match="beyond"):
        flash.erase(0, SECTOR_BYTES + 1)
    with pytest.raises(ValueError, match="no sector starts"):
        flash.erase(1, 1)


def test_file_behind_it_has_every_write_at_once_torn_ones_too(tmp_path):
    path = tmp_path / "flash"
    path.write_bytes(bytes(SECTOR_BYTES))
    flash = Flash(bytearray(SECTOR_BYTES), os.open(path, os.O_RDWR))
    flash.erase(0, SECTOR_BYTES)
    flash.program(5, b"abc")
    assert path.read_bytes() == bytes(flash.image)
    flash.cut_after(1)
    with pytest.raises(PowerCut):
        flash.program(100, bytes(3))
    assert path.read_bytes() == bytes(flash.image)
    flash.close()
    flash.close()
