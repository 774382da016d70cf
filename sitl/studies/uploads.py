"""Durations of many uploads over the channels of the table of targets, and their lower bound.

The channel has 2 ms slots and 4 ms from the end of a slot to delivery. UPLOAD_BEGIN, sent first on an idle
link, is therefore answered after about 20 ms, including serial lines, ticks and slots: 18 ms without jitter,
mostly 22 ms with jitter. Duplicates, corruption and jitter are the simulator's defaults. Loss is that of full
frames; short ones are lost less often.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from trimtab.protocol.blobs import Kind
from trimtab.protocol.messages import UploadStatus
from trimtab.protocol.signing import SigningKey
from trimtab.protocol.upload import CHUNK_BYTES, SIGNED_CHUNK_BYTES, SenderState, UploadSender
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
"""No loss; independent loss (a Gilbert-Elliott chain with independent states has bursts of 1 / (1 - loss)
frames); bursts of 5; bursts of 20.
"""
GIVE_UP_US = 120_000_000
_BLOBS = 4


def bound_s(size: int, radio: RadioSettings) -> float:
    """Return the least mean duration, s, of a blob's chunks: one in every slot, lost ones repeated."""
    return chunk_count(size) * radio.slot_us * 1e-6 / (1.0 - radio.loss)


def time_upload(channel: str, seed: int, number: int, key: SigningKey | None = None) -> dict[str, Any]:
    """Run one upload and return plain data: seconds from its first message to the confirmation, and chunks.

    `seconds` is None if the upload failed or another blob became live. With a key, all messages are signed.
    """
    chunk_bytes = CHUNK_BYTES if key is None else SIGNED_CHUNK_BYTES
    answered: list[int] = []

    def on_message(now_us: int, is_sent: bool, message: Any) -> None:
        if not is_sent and not answered and isinstance(message, UploadStatus):
            answered.append(now_us)

    rig = UploadRig(
        reference_blob("research", 1 + number % _BLOBS),
        old=reference_blob("research", 0),
        radio=CHANNELS[channel],
        seed=seed,
        number=number,
        make_sender=lambda blob: UploadSender(blob, Kind.REFERENCE, chunk_bytes=chunk_bytes),
        on_message=on_message,
        key=key,
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
    """Return runs and failures, and the mean, median, 99th percentile and maximum of the seconds."""
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
