"""The blobs on board as files: one folder for each kind, with the live and the staged blob.

| path | read | write |
|---|---|---|
| /ref/live.ref, /ff/live.ff | the exact bytes of the live blob | never |
| /ref/staged.ref, /ff/staged.ff | the staged blob | the complete file is checked on board, then staged |
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

from trimtab.firmware_model.storage.store import ReferenceStore
from trimtab.protocol.blob_fields import HEADER_BYTES
from trimtab.protocol.blobs import BlobError, Kind, least_bytes
from trimtab.protocol.messages import UploadResult, mavlink
from trimtab.protocol.upload import ReceiverEvent, UploadReceiver

_WARNING = mavlink.MAV_SEVERITY_WARNING
_INFO = mavlink.MAV_SEVERITY_INFO


class File(NamedTuple):
    """A file that may exist."""

    kind: Kind
    staged: bool


@dataclass(frozen=True, kw_only=True)
class Entry:
    """An entry of a directory listing. size: bytes; None for a folder."""

    name: str
    size: int | None


FOLDERS = {"ref": Kind.REFERENCE, "ff": Kind.FEEDFORWARD}
FILES = {
    f"{folder}/{'staged' if staged else 'live'}.{folder}": File(kind, staged)
    for folder, kind in FOLDERS.items()
    for staged in (False, True)
}
"""Files by path without the leading slash."""
_REASONS = {
    UploadResult.BUSY: "an upload or a swap is in progress",
    UploadResult.TOO_LARGE: "too large",
    UploadResult.BAD_REQUEST: "empty",
}


class BlobFiles:
    """Reads and writes blobs by path.

    Parameters
    ----------
    text
        Sends severity and text to the host.
    on_upload
        Receives the events of writing and removing a file, and the time.
    least_bytes
        Returns the least length of a blob by its first bytes; raises BlobError if they begin no blob.
    """

    def __init__(
        self,
        *,
        store: ReferenceStore,
        upload: UploadReceiver,
        text: Callable[[int, str], None],
        on_upload: Callable[[list[ReceiverEvent], int], None],
        least_bytes: Callable[[bytes], int] = least_bytes,
    ) -> None:
        self.bytes_max = store.blob_bytes_max
        self._store = store
        self._upload = upload
        self._text = text
        self._on_upload = on_upload
        self._least_bytes = least_bytes

    @staticmethod
    def find(path: str) -> File | None:
        """Return the file at this path, or None if the path is never valid."""
        return FILES.get(path.lstrip("/"))

    def entries(self, path: str) -> list[Entry] | None:
        """Return the entries of a folder, or None if there is no such folder."""
        folder = path.strip("/")
        if folder == "":
            return [Entry(name=name, size=None) for name in FOLDERS]
        if folder not in FOLDERS:
            return None
        entries = []
        for name, file in FILES.items():
            data = self.read(file)
            if name.startswith(f"{folder}/") and data is not None:
                entries.append(Entry(name=name.partition("/")[2], size=len(data)))
        return entries

    def read(self, file: File) -> bytes | None:
        """Return the bytes of a file on board, or None if it does not exist."""
        if not file.staged:
            return self._store.live(file.kind)
        kind, _ = self._upload.staged()
        return self._store.staged(file.kind) if kind == file.kind else None

    def check_start(self, path: str, head: bytes) -> UploadResult:
        """Return TOO_LARGE or BAD_REQUEST if a file that begins with `head` can only be refused, else OK.

        A text gives the reason. The complete file is still checked by `write`.
        """
        if len(head) < HEADER_BYTES:
            return UploadResult.OK
        try:
            size = self._least_bytes(head)
        except BlobError as error:
            self._text(_WARNING, f"{_name(path)} refused:")
            self._text(_WARNING, str(error))
            return UploadResult.BAD_REQUEST
        if size <= self.bytes_max:
            return UploadResult.OK
        self._text(_WARNING, f"{_name(path)} refused: {size} bytes, at most {self.bytes_max}")
        return UploadResult.TOO_LARGE

    def write(self, path: str, data: bytes, now_us: int) -> bool:
        """Stage `data`; return False if it was refused. A text reports the result."""
        file = self.find(path)
        assert file is not None, "only valid paths are opened"
        result, verdict, events = self._upload.put(file.kind, data, now_us)
        self._on_upload(events, now_us)
        name = _name(path)
        if result is UploadResult.OK:
            self._text(_INFO, f"{name} accepted: {len(data)} bytes")
            return True
        if verdict is None or verdict.ok:
            self._text(_WARNING, f"{name} refused: {_REASONS.get(result, result.name.lower())}")
        else:
            node = "" if verdict.node is None else f" at node {verdict.node}"
            self._text(_WARNING, f"{name} refused{node}:")
            self._text(_WARNING, verdict.message)
        return False

    def report_incomplete(self, path: str, count: int, size: int) -> None:
        """Report a file that was closed after `count` of `size` bytes."""
        self._text(_WARNING, f"{_name(path)} refused: {size - count} of {size} bytes missing")

    def remove(self, file: File, now_us: int) -> bool:
        """Remove a staged file; return False if there was none."""
        result, events = self._upload.remove(file.kind, now_us)
        self._on_upload(events, now_us)
        return result is UploadResult.OK


def _name(path: str) -> str:
    """Return the last part of a path."""
    return path.rpartition("/")[2]
