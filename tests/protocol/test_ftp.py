"""The bytes inside FILE_TRANSFER_PROTOCOL."""

import zlib

import pytest
from hypothesis import given
from hypothesis import strategies as st

from trimtab.protocol.ftp import DATA_BYTES, Opcode, Packet, crc32


def test_packet_by_hand():
    packet = Packet(number=0x0102, session=3, opcode=Opcode.WRITE_FILE, size=2, offset=0x04030201, data=b"ab")
    payload = packet.encode()
    assert payload[:14].hex() == "020103070200000001020304" + b"ab".hex()
    assert len(payload) == 251
    assert Packet.decode(payload) == packet


@given(st.binary(max_size=300))
def test_any_bytes_decode_and_encode_again(payload):
    packet = Packet.decode(payload)
    assert len(packet.data) <= DATA_BYTES
    assert Packet.decode(packet.encode()) == packet


def test_too_much_data_is_refused():
    with pytest.raises(ValueError, match="at most 239 bytes, not 240"):
        Packet(number=0, session=0, opcode=7, data=bytes(240)).encode()


def test_checksum_has_neither_initial_value_nor_inversion():
    # Of a single 1 byte: the table entry of the polynomial.
    assert crc32(b"\1") == 0x77073096
    assert crc32(b"") == 0
    assert crc32(b"trimtab") == zlib.crc32(b"trimtab", 0xFFFFFFFF) ^ 0xFFFFFFFF
