"""Air time of a radio frame, from its length and bit rate."""

from __future__ import annotations

MAC_BYTES = 11
"""Header and checksum of an 802.15.4 frame."""
_AHEAD_US = {850_000: 289, 6_800_000: 163}
"""Preamble, delimiter and physical header. With it, 127 B take 1.71 and 0.34 ms, as on transceivers."""
_CODED_BITS, _PARITY_BITS = 330, 48
"""Each started block of 330 bits carries 48 bits of parity (Reed-Solomon)."""


def air_us(size: int, bit_rate: int) -> int:
    """Return the air time, us, of a frame with `size` bytes of payload at 850,000 or 6,800,000 bit/s."""
    bits = 8 * (size + MAC_BYTES)
    bits += _PARITY_BITS * -(-bits // _CODED_BITS)
    return _AHEAD_US[bit_rate] + -(-bits * 1_000_000 // bit_rate)
