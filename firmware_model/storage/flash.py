"""Model of the flash memory of a flight controller: sectors are erased, and bits are cleared.

Erasing sets a sector to 0xFF. Programming can only clear bits. A power cut leaves the bytes before it
written, the byte being programmed partly written, and all later bytes unchanged. The model does not include
pages, erase times and wear.
"""

from __future__ import annotations

import os

SECTOR_BYTES = 4096
ERASED = b"\xff"


class PowerCut(Exception):
    """Power failed during a write: the firmware stops here."""


class Flash:
    """Flash of a whole number of sectors.

    Parameters
    ----------
    image
        Content of the memory, changed in place.
    file
        Descriptor of a file with the same content. Every write goes to it immediately, so a killed process
        leaves exactly the bytes it had written. None: the memory lasts as long as the object.

    Attributes
    ----------
    written
        Number of bytes erased or programmed since construction.
    """

    def __init__(self, image: bytearray, file: int | None = None) -> None:
        if not image or len(image) % SECTOR_BYTES:
            raise ValueError(f"flash has whole sectors of {SECTOR_BYTES} bytes, not {len(image)} bytes")
        self.image = image
        self.written = 0
        self._file = file
        self._bytes_until_cut: int | None = None

    @classmethod
    def blank(cls, size: int) -> Flash:
        """Return erased memory of `size` bytes."""
        return cls(bytearray(ERASED) * size)

    def cut_after(self, count: int) -> None:
        """Make power fail after `count` more bytes. Every later write raises PowerCut."""
        self._bytes_until_cut = count

    def read(self, start: int, size: int) -> bytes:
        """Return `size` bytes from `start` on."""
        return bytes(self.image[start : start + size])

    def blank_at(self, start: int, size: int) -> bool:
        """Return whether all these bytes are erased."""
        return self.image[start : start + size] == ERASED * size

    def program(self, start: int, data: bytes) -> None:
        """Clear the bits from `start` on that are 0 in `data`.

        Raises ValueError beyond the end of the memory, and PowerCut if power fails.
        """
        size = len(data)
        self._check(start, size)
        old = int.from_bytes(self.image[start : start + size], "big")
        new = (old & int.from_bytes(data, "big")).to_bytes(size, "big")
        done = self._power(size)
        if done < size:
            half = self.image[start + done] & (new[done] | 0xF0)
            self._write(start, new[:done] + bytes((half,)))
            raise PowerCut
        self._write(start, new)

    def erase(self, start: int, size: int) -> None:
        """Erase, one after another, the sectors from `start` on that hold `size` bytes.

        Raises ValueError if no sector starts at `start` or beyond the end of the memory, and PowerCut if
        power fails.
        """
        if start % SECTOR_BYTES:
            raise ValueError(f"no sector starts at {start}")
        for sector in range(start, start + size, SECTOR_BYTES):
            self._check(sector, SECTOR_BYTES)
            done = self._power(SECTOR_BYTES)
            self._write(sector, ERASED * done)
            if done < SECTOR_BYTES:
                raise PowerCut

    def close(self) -> None:
        """Close the file behind the flash, if any."""
        if self._file is not None:
            os.close(self._file)
            self._file = None

    def _power(self, size: int) -> int:
        """Return how many of `size` bytes can be written before the power cut."""
        if self._bytes_until_cut is None:
            return size
        done = min(size, self._bytes_until_cut)
        self._bytes_until_cut -= done
        return done

    def _check(self, start: int, size: int) -> None:
        if start < 0 or start + size > len(self.image):
            raise ValueError(f"{size} bytes from {start} on are beyond the {len(self.image)} of the memory")

    def _write(self, start: int, data: bytes) -> None:
        self.image[start : start + len(data)] = data
        self.written += len(data)
        if self._file is not None:
            os.pwrite(self._file, data, start)
