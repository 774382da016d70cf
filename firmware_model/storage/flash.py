"""Non-volatile memory as a flight controller has it: flash, erased by the sector and written bit by bit.

Erasing sets a sector to 0xFF; programming can only clear bits. A power cut in between leaves the bytes before
it written, a byte that was being programmed half, and the rest as they were. Pages, the time an erase takes
and wear are not modelled.
"""

from __future__ import annotations

import os

SECTOR_BYTES = 4096
ERASED = b"\xff"


class PowerCut(Exception):
    """Power failed in the middle of a write; whoever was running is gone."""


class Flash:
    """Flash of a whole number of sectors.

    Parameters
    ----------
    image
        what it holds; changed in place.
    file
        descriptor of a file with the same content, which gets every write at once, so that a killed
        process leaves exactly what it had written. None: the memory lasts as long as the object.

    Attributes
    ----------
    written
        bytes erased and programmed since construction.
    """

    def __init__(self, image: bytearray, file: int | None = None) -> None:
        if not image or len(image) % SECTOR_BYTES:
            raise ValueError(f"flash has whole sectors of {SECTOR_BYTES} bytes, not {len(image)} bytes")
        self.image = image
        self.written = 0
        self._file = file
        self._left: int | None = None

    @classmethod
    def blank(cls, size: int) -> Flash:
        """Erased memory of `size` bytes."""
        return cls(bytearray(ERASED) * size)

    def cut_after(self, count: int) -> None:
        """Let power fail after `count` more bytes are written; PowerCut from then on."""
        self._left = count

    def read(self, start: int, size: int) -> bytes:
        """Return the `size` bytes from `start` on."""
        return bytes(self.image[start : start + size])

    def blank_at(self, start: int, size: int) -> bool:
        """Whether these bytes are all erased."""
        return self.image[start : start + size] == ERASED * size

    def program(self, start: int, data: bytes) -> None:
        """Clear the bits from `start` on that are 0 in `data`.

        Raises ValueError beyond the end, PowerCut where power fails on the way.
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
        """Erase, one by one, the sectors from `start` on that hold `size` bytes.

        Raises ValueError where `start` begins no sector or beyond the end, PowerCut where power fails.
        """
        if start % SECTOR_BYTES:
            raise ValueError(f"no sector begins at {start}")
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
        """How many of `size` bytes there is still power for."""
        if self._left is None:
            return size
        done = min(size, self._left)
        self._left -= done
        return done

    def _check(self, start: int, size: int) -> None:
        if start < 0 or start + size > len(self.image):
            raise ValueError(f"{size} bytes from {start} on are beyond the {len(self.image)} of the memory")

    def _write(self, start: int, data: bytes) -> None:
        self.image[start : start + len(data)] = data
        self.written += len(data)
        if self._file is not None:
            os.pwrite(self._file, data, start)
