"""How long a radio frame is in the air, by length and bit rate."""

from __future__ import annotations

MAC_BYTES = 11
"""Header and checksum of an 802.15.4 frame around what it carries."""
_AHEAD_US = {850_000: 289, 6_800_000: 163}
"""Preamble, delimiter and physical header: what makes 127 B take 1.71 and 0.34 ms, as transceivers do."""
_CODED_BITS, _PARITY_BITS = 330, 48
"""Each begun block of so many bits carries so many more of parity (Reed-Solomon)."""


def air_us(size: int, bit_rate: int) -> int:
    """Microseconds on the air of a frame that carries `size` bytes at 850,000 or 6,800,000 bit/s."""
    bits = 8 * (size + MAC_BYTES)
    bits += _PARITY_BITS * -(-bits // _CODED_BITS)
    return _AHEAD_US[bit_rate] + -(-bits * 1_000_000 // bit_rate)
