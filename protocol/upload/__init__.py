"""Upload of blobs: content-addressed, in chunks with selective repeat, checked on board, atomic commit.

The SHA-256 of a blob identifies it. UPLOAD_BEGIN announces a blob and asks for the upload's progress. The
vehicle answers every BEGIN, COMMIT and ABORT with UPLOAD_STATUS. It also reports from time to time which
chunks it holds. A chunk is in non-volatile memory before the vehicle reports it, so a power cut causes no
repeated transfer. When all chunks are held, the vehicle checks the blob, digest first, and answers with
UPLOAD_VERDICT. UPLOAD_COMMIT then makes the blob live: immediately or, for a reference that continues the one
in flight, at an agreed tick. Every message may be lost, late or repeated: messages are idempotent, and an end
that waits for an answer repeats its request.

Both ends are state machines without I/O. The receiver's `receive(message, now_us)` and
`advance(now_us)` return events.
`send(now_us)` returns the messages that are due. `next_deadline_us()` returns the time of the next call.
"""

from trimtab.protocol.upload.current_blob import BlobStore
from trimtab.protocol.upload.receiver import UploadReceiver
from trimtab.protocol.upload.sender import SenderState, UploadSender
from trimtab.protocol.upload.transfer import (
    CHUNK_BYTES,
    SIGNED_CHUNK_BYTES,
    Incoming,
    ReceiverEvent,
    SwapAnswer,
    UploadEvent,
    Verdict,
)

__all__ = [
    "CHUNK_BYTES",
    "SIGNED_CHUNK_BYTES",
    "BlobStore",
    "Incoming",
    "ReceiverEvent",
    "SenderState",
    "SwapAnswer",
    "UploadEvent",
    "UploadReceiver",
    "UploadSender",
    "Verdict",
]
