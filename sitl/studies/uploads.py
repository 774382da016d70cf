"""Uploads over the air of the table of targets, many times: how long they take, and what the least is.

The channel: 2 ms slots, and 4 ms from a slot's end to delivery, so that UPLOAD_BEGIN, which leaves as the
first thing on a quiet link, is answered after about 20 ms (serial lines, ticks and slots included): 18 ms
without jitter, mostly 22 ms with. Duplicates, damage and jitter are the simulator's own. Loss is of full
frames, short ones fare better.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from trimtab.protocol.messages import UploadStatus
from trimtab.protocol.upload import SenderState
from trimtab.protocol.upload.transfer import chunk_count
from trimtab.sitl.studies.upload_blob import reference_blob
from trimtab.sitl.studies.upload_rig import UploadRig
from trimtab.sitl.world import RadioSettings

LATENCY_US = 4_000
LOSS = 0.1
CHANNELS = {
    "clean": RadioSettings(loss=0.0, latency_us=LATENCY_US),
    "upload": RadioSettings(loss=LOSS, burst_frames=1.0 / (1.0 - LOSS), latency_us=LATENCY_US),
    "burst5": RadioSettings(loss=0.3, burst_frames=5.0, latency_us=LATENCY_US),
    "burst20": RadioSettings(loss=LOSS, burst_frames=20.0, latency_us=LATENCY_US),
}
"""No loss; each frame lost on its own (a Gilbert-Elliott chain whose next state does not depend on the last
has spells of 1 / (1 - loss) frames); spells of 5; spells of 20.
"""
GIVE_UP_US = 120_000_000
_BLOBS = 4


def bound_s(size: int, radio: RadioSettings) -> float:
    """Seconds that the chunks of a blob take at least in the mean: every slot holds one, lost ones again."""
    return chunk_count(size) * radio.slot_us * 1e-6 / (1.0 - radio.loss)


def time_upload(channel: str, seed: int, number: int) -> dict[str, Any]:
    """One upload as plain data: seconds from its first message to the word that the blob is live, frames.

    seconds is None where it failed, or the blob is not what became live.
    """
    answered: list[int] = []

    def heard(now_us: int, said: bool, message: Any) -> None:
        if not said and not answered and isinstance(message, UploadStatus):
            answered.append(now_us)

    rig = UploadRig(
        reference_blob("research", 1 + number % _BLOBS),
        old=reference_blob("research", 0),
        radio=CHANNELS[channel],
        seed=seed,
        number=number,
        on_message=heard,
    )
    rig.run(GIVE_UP_US)
    whole = rig.sender.state is SenderState.DONE and rig.live == rig.blob
    return {
        "seconds": (rig.now_us - rig.begin_us) * 1e-6 if whole else None,
        "answered_s": (answered[0] - rig.begin_us) * 1e-6 if answered else None,
        "chunks_sent": rig.sender.chunks_sent,
    }


def percentile(values: Iterable[float], share: float) -> float:
    """Return the smallest of the values that is not exceeded by at least this share of them."""
    return float(np.quantile(list(values), share, method="inverted_cdf"))


def figures(rows: Sequence[Mapping[str, Any]]) -> dict[str, float | int | None]:
    """Of uploads: how many, how many failed, seconds in the mean, median, 99th percentile and at most."""
    times = [row["seconds"] for row in rows if row["seconds"] is not None]
    failed = len(rows) - len(times)
    if failed or not times:
        return {"runs": len(rows), "failed": failed, **dict.fromkeys(("mean_s", "p50_s", "p99_s", "max_s"))}
    return {
        "runs": len(rows),
        "failed": 0,
        "mean_s": sum(times) / len(times),
        "p50_s": percentile(times, 0.5),
        "p99_s": percentile(times, 0.99),
        "max_s": max(times),
    }
