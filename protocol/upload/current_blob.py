"""The blob that is being received, with the chunks that the store holds."""

from __future__ import annotations

import hashlib
from typing import NamedTuple, Protocol

from trimtab.protocol.upload.transfer import CHUNK_BYTES, Incoming, chunk_count


class BlobStore(Protocol):
    """Store of blobs: one live blob of each kind, and one that is received and then staged."""

    def live(self, kind: int) -> bytes | None: ...
    def incoming(self) -> Incoming | None: ...
    def begin(self, kind: int, size: int, digest: bytes, chunk_bytes: int) -> None: ...
    def put(self, kind: int, index: int, chunk: bytes) -> None: ...
    def received(self, kind: int) -> bytes: ...
    def stage(self, kind: int, blob: bytes) -> object: ...
    def commit(self, kind: int) -> object: ...
    def discard(self, kind: int) -> None: ...


class BlobIdentity(NamedTuple):
    """Identity of a blob in a message: SHA-256 digest, kind, size in bytes; and the size of its chunks."""

    digest: bytes = b""
    kind: int = 0
    size: int = 0
    chunk_bytes: int = CHUNK_BYTES

    @property
    def id(self) -> str:
        """The first 6 bytes of the digest, in hexadecimal digits."""
        return self.digest[:6].hex()


NO_BLOB = BlobIdentity()


class CurrentBlob:
    """The blob being received, or NO_BLOB. Its chunks are in the store; `held_chunks` is 1 for each one."""

    def __init__(self, store: BlobStore) -> None:
        self.blob = NO_BLOB
        self.held_chunks = bytearray()
        self._store = store

    def __bool__(self) -> bool:
        """Return whether a blob is being received."""
        return self.blob is not NO_BLOB

    @property
    def chunks(self) -> int:
        """Number of chunks of the blob."""
        return len(self.held_chunks)

    @property
    def held(self) -> int:
        """Number of chunks held."""
        return self.held_chunks.count(1)

    def has_digest(self, digest: bytes) -> bool:
        """Return whether the current blob has this digest."""
        return bool(self) and digest == self.blob.digest

    def begin(self, blob: BlobIdentity) -> None:
        """Start to receive `blob`."""
        self.blob = blob
        self.held_chunks = bytearray(chunk_count(blob.size, blob.chunk_bytes))
        self._store.begin(blob.kind, blob.size, blob.digest, blob.chunk_bytes)

    def put(self, index: int, data: bytes) -> None:
        """Store chunk `index`. `data` may be padded at its end."""
        start = index * self.blob.chunk_bytes
        stop = min(start + self.blob.chunk_bytes, self.blob.size)
        self._store.put(self.blob.kind, index, data[: stop - start])
        self.held_chunks[index] = 1

    def resume(self, incoming: Incoming) -> None:
        """Continue the upload that the store holds."""
        self.blob = BlobIdentity(incoming.digest, incoming.kind, incoming.size, incoming.chunk_bytes)
        self.held_chunks = incoming.held

    def data(self) -> bytes:
        """Return the bytes received."""
        return self._store.received(self.blob.kind)

    def is_intact(self) -> bool:
        """Return whether the bytes received match the digest."""
        return hashlib.sha256(self.data()).digest() == self.blob.digest

    def forget(self, *, discard: bool) -> None:
        """Reset to NO_BLOB. discard: also remove the bytes from the store."""
        if discard and self.blob.kind:
            self._store.discard(self.blob.kind)
        self.blob = NO_BLOB
        self.held_chunks = bytearray()
