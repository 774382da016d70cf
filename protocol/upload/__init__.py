"""Transfer of blobs: content-addressed, in chunks with selective repeat, checked on board, committed in one
step.

A blob is known by its SHA-256. UPLOAD_BEGIN announces it and asks how far it is; the vehicle answers every
BEGIN, COMMIT and ABORT with UPLOAD_STATUS, and says now and then which chunks it holds; these are in memory
that outlives a power cut before they are named, so that neither end sends or asks twice. What it has in full
it checks, digest first, and answers with UPLOAD_VERDICT; UPLOAD_COMMIT then makes it live, at once or, for a
reference that continues the one in flight, at an agreed tick. Every message
may be lost, late or repeated: all of them mean the same the second time, and whoever waits asks again.

Both ends are state machines without I/O. `receive(message, now_us)` and `advance(now_us)` return events,
`send(now_us)` returns the messages that are due, `next_deadline_us()` says when to call again at the latest.
"""

from trimtab.protocol.upload.blob_in_hand import BlobStore
from trimtab.protocol.upload.receiver import UploadReceiver
from trimtab.protocol.upload.sender import SenderState, UploadSender
from trimtab.protocol.upload.transfer import (
    CHUNK_BYTES,
    Agreement,
    Incoming,
    ReceiverEvent,
    UploadEvent,
    Verdict,
)

__all__ = [
    "CHUNK_BYTES",
    "Agreement",
    "BlobStore",
    "Incoming",
    "ReceiverEvent",
    "SenderState",
    "UploadEvent",
    "UploadReceiver",
    "UploadSender",
    "Verdict",
]
