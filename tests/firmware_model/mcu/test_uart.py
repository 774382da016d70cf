"""UART model against a byte-by-byte simulation, its overrun counter and its interrupts."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from trimtab.firmware_model.clock import NEVER_US
from trimtab.firmware_model.mcu.uart import UartPort, connect


def pair(baud=1_000_000, rx_bytes=64, tx_bytes=256):
    a = UartPort(baud=baud, rx_bytes=rx_bytes, tx_bytes=tx_bytes)
    b = UartPort(baud=baud, rx_bytes=rx_bytes, tx_bytes=tx_bytes)
    connect(a, b)
    return a, b


def test_read_before_the_last_byte_arrived_returns_the_bytes_due():
    a, b = pair()  # 10 us a byte
    assert a.write(b"abcdef", 100)
    assert b.read(109) == b""
    assert b.read(110) == b"a"
    assert b.read(139) == b"bc"
    assert b.read(10_000) == b"def"
    assert b.overruns == 0


def test_second_write_while_the_line_is_busy_waits_its_turn():
    a, b = pair()
    a.write(b"ab", 0)
    a.write(b"cd", 5)
    assert b.read(20) == b"ab"
    assert b.read(30) == b"c"
    assert b.read(40) == b"d"


def test_buffer_full_counts_every_lost_byte_and_recovers():
    a, b = pair(rx_bytes=4)
    a.write(bytes(range(10)), 0)
    assert b.read(1_000) == bytes(range(4))
    assert b.overruns == 6
    a.write(b"next", 1_000)
    assert b.read(2_000) == b"next"
    assert b.overruns == 6


def test_write_without_room_is_refused_whole():
    a, b = pair(tx_bytes=8)
    assert a.write(b"12345678", 0)
    assert a.tx_free(0) == 0
    assert not a.write(b"9", 0)
    assert a.refused == 1
    assert a.tx_free(10) == 1
    assert a.write(b"9", 10)
    assert b.read(1_000) == b"123456789"


def test_due_is_a_chunk_or_a_line_that_was_quiet_long_enough():
    a = UartPort(baud=1_000_000, rx_bytes=64, tx_bytes=256)
    b = UartPort(baud=1_000_000, rx_bytes=64, tx_bytes=256, chunk_bytes=6, idle_us=25)
    connect(a, b)
    a.write(b"abcd", 0)
    assert b.due_us == 65  # 40 us of bytes, 25 of silence
    a.write(b"ef", 60)
    assert b.due_us == 80  # the silence was too short: the chunk is full
    assert b.read(80) == b"abcdef"
    a.write(b"gh", 100)
    a.write(b"ij", 200)
    assert b.due_us == 145
    assert b.read(145) == b"gh"
    assert b.due_us == 245


def test_due_is_the_end_of_a_burst_or_half_a_buffer():
    a, b = pair(rx_bytes=20)
    assert b.due_us == NEVER_US
    a.write(b"abcd", 7)
    assert b.due_us == 47
    a.write(b"efgh", 20)
    assert b.due_us == 87  # one burst
    a.write(b"late", 500)
    assert b.due_us == 87  # idle in between
    assert b.read(b.due_us) == b"abcdefgh"
    assert b.due_us == 540
    assert b.read(540) == b"late"
    a.write(bytes(30), 1_000)
    assert b.due_us == 1_100  # half of 20
    assert b.read(1_100) == bytes(10)
    assert b.due_us == 1_200


def test_due_with_a_baud_that_is_no_whole_number_of_us_has_all_bytes():
    a, b = pair(baud=921_600, rx_bytes=200)
    a.write(b"x" * 48, 3)
    assert b.due_us == 3 + -(-48 * 10_000_000 // 921_600)
    assert len(b.read(b.due_us)) == 48


def test_unread_line_stays_bounded_and_is_counted():
    a, b = pair(rx_bytes=16)
    for k in range(2_000):
        a.write(b"ab", 100 * k)
    assert len(b._incoming) < 300
    assert b.read(10_000_000) == b"ab" * 8
    assert b.overruns == 4_000 - 16


def test_connect_twice_raises():
    a, _ = pair()
    with pytest.raises(ValueError, match="connected"):
        connect(a, UartPort(baud=1, rx_bytes=1, tx_bytes=1))
    with pytest.raises(ValueError, match="rx_bytes"):
        UartPort(baud=1, rx_bytes=0, tx_bytes=1)


@given(
    st.lists(st.tuples(st.integers(0, 300), st.integers(1, 12)), max_size=12),
    st.lists(st.integers(1, 400), max_size=12),
    st.sampled_from([115_200, 921_600, 1_000_000]),
)
def test_pipe_against_byte_by_byte_model_agrees(writes, reads, baud):
    rx = 8
    a, b = pair(baud=baud, rx_bytes=rx, tx_bytes=10_000)
    arrivals, clock, line_free, value = [], 0, 0, 0
    for gap, count in writes:
        clock += gap
        data = bytes((value + k) % 256 for k in range(count))
        value += count
        a.write(data, clock)
        start = max(clock * baud, line_free)
        for byte in data:
            start += 10_000_000
            arrivals.append((start, byte))
        line_free = start
    now, position, lost = 0, 0, 0
    for step in [*reads, 1_000_000]:
        now += step
        got = []
        while position < len(arrivals) and arrivals[position][0] <= now * baud:
            if len(got) < rx:
                got.append(arrivals[position][1])
            else:
                lost += 1
            position += 1
        assert b.read(now) == bytes(got)
    assert b.overruns == lost
