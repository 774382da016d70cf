"""Playback of a track: writes its current pieces and the time inside them to the engine."""

from __future__ import annotations

from trimtab.firmware_model.clock import NEVER_US
from trimtab.firmware_model.flight.track import Track
from trimtab.firmware_model.law.reference import cubic_at, septic_at


class Player:
    """Playback position on a track.

    A tick calls `switch` if `switch_us` has been reached and writes the time inside the pieces,
    `piece[0] = (now_us - piece_us) * 1e-6` and likewise for yaw. It has no other cost.

    Parameters
    ----------
    piece, yaw
        Input blocks of the engine.
    """

    def __init__(self, piece: memoryview[float], yaw: memoryview[float]) -> None:
        self.piece = piece
        self.yaw = yaw
        self.piece_us = 0
        self.yaw_us = 0
        self.switch_us = NEVER_US
        self._track: Track | None = None
        self._start_us = 0
        self._next_piece = 0
        self._next_yaw = 0

    def start(self, track: Track, now_us: int) -> None:
        """Start the track: its time 0 is now."""
        self._track = track
        self._start_us = now_us
        self._next_piece = self._next_yaw = 0
        self.switch(now_us)

    def hold_first_piece(self, track: Track, now_us: int) -> None:
        """Load the first piece of a track and keep it without a time limit."""
        self.start(track, now_us)
        self.switch_us = NEVER_US

    def reference(self, now_us: int) -> tuple[float, ...]:
        """Return position, velocity, acceleration, jerk (NED), yaw and yaw rate at `now_us`, 14 numbers."""
        p, v, a, j, _ = septic_at(self.piece[1:], (now_us - self.piece_us) * 1e-6)
        return (*p, *v, *a, *j, *cubic_at(self.yaw[1:], (now_us - self.yaw_us) * 1e-6))

    def switch(self, now_us: int) -> bool:
        """Write the current pieces, which apply until `switch_us`; return whether the track has ended."""
        track, start = self._track, self._start_us
        if track is None or now_us >= start + track.end_us:
            self.switch_us = NEVER_US
            return True
        starts, yaw_starts, at_us = track.starts_us, track.yaw_starts_us, now_us - start
        k = self._next_piece
        if k < len(starts) and starts[k] <= at_us:
            while k + 1 < len(starts) and starts[k + 1] <= at_us:
                k += 1
            self.piece[:] = track.blocks[k]
            self.piece_us = start + starts[k]
            self._next_piece = k = k + 1
        y = self._next_yaw
        if y < len(yaw_starts) and yaw_starts[y] <= at_us:
            while y + 1 < len(yaw_starts) and yaw_starts[y + 1] <= at_us:
                y += 1
            self.yaw[:] = track.yaw_blocks[y]
            self.yaw_us = start + yaw_starts[y]
            self._next_yaw = y = y + 1
        self.switch_us = start + min(
            starts[k] if k < len(starts) else track.end_us,
            yaw_starts[y] if y < len(yaw_starts) else track.end_us,
        )
        return False
