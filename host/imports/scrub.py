"""Removal of what tells where, when and by whom a flight was flown, for sharing it."""

from __future__ import annotations

from dataclasses import replace

from trimtab.host.imports.recording import Recording

SOURCE = "scrubbed"
"""Name of the source in a scrubbed log."""


def scrubbed(recording: Recording) -> Recording:
    """Return the recording without its file name and epoch, with positions from its first pose."""
    origin = recording.p_ned[0]
    p_ref = recording.p_ref_ned
    return replace(
        recording,
        source=SOURCE,
        p_ned=recording.p_ned - origin,
        p_ref_ned=None if p_ref is None else p_ref - origin,
        epoch_us=None,
    )
