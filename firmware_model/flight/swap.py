"""Check whether a staged reference may take over in flight: it must continue the present one and end at rest.

The bounds of a jump are far above the rounding of float32 and too small to affect a controller.
"""

from __future__ import annotations

from trimtab.firmware_model.flight.track import Track
from trimtab.firmware_model.flight.verdict import Reason
from trimtab.firmware_model.law.checks import check_ends
from trimtab.firmware_model.law.limits import Limits
from trimtab.firmware_model.law.smoothness import jump_text, jumps
from trimtab.protocol.blobs import Reference
from trimtab.protocol.messages import UploadResult
from trimtab.protocol.upload import SwapAnswer, Verdict

AHEAD_US = 100_000
"""Least time from the agreement to the swap."""


def agree_swap(
    live: Track, blob: Reference, following: Track, *, at_us: int, ahead_us: int, limits: Limits
) -> SwapAnswer:
    """Return whether `following`, the track of `blob`, takes over `at_us` after the start of `live`.

    ahead_us: time from now to the swap.
    """
    if ahead_us < AHEAD_US:
        return _too_late(f"the swap is {ahead_us / 1000:.0f} ms ahead, below {AHEAD_US // 1000} ms", ahead_us)
    if at_us >= live.end_us:
        text = f"the swap is at {at_us * 1e-6:.3f} s, the end at {live.end_us * 1e-6:.3f} s"
        return _too_late(text, at_us, live.end_us)
    end = check_ends(blob.nodes, limits, blob.origin_ned, ends=(len(blob.nodes) - 1,))
    if end is not None:
        return _refused(int(end.reason_code), end.node, end.value, end.bound, end.text)
    before, after = live.state_at(max(0, at_us)), following.state_at(0)
    jump = jump_text(jumps(before, after))
    if jump is not None:
        text, value, bound = jump
        return _refused(Reason.NOT_CONTINUOUS, 0, value, bound, text)
    return SwapAnswer()


def _refused(reason: int, node: int, value: float, bound: float, text: str) -> SwapAnswer:
    verdict = Verdict(ok=False, node=node, reason=reason, value=value, bound=bound, message=text)
    return SwapAnswer(result=UploadResult.NOT_CONTINUOUS, verdict=verdict)


def _too_late(text: str, value_us: int, bound_us: int = AHEAD_US) -> SwapAnswer:
    verdict = Verdict(
        ok=False, reason=Reason.TOO_LATE, value=value_us * 1e-6, bound=bound_us * 1e-6, message=text
    )
    return SwapAnswer(result=UploadResult.TOO_LATE, verdict=verdict)
