"""The blobs on board as files: a folder a kind, in it what is live and what is staged.

| path | read | write |
|---|---|---|
| /ref/live.ref, /ff/live.ff | what flies, byte by byte | never |
| /ref/staged.ref, /ff/staged.ff | what waits for a commit | checked on board as a whole, then staged |
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

from trimtab.firmware_model.storage.store import ReferenceStore
from trimtab.protocol.blobs import Kind
from trimtab.protocol.messages import UploadResult, mavlink
from trimtab.protocol.upload import ReceiverEvent, UploadReceiver

_WARNING = mavlink.MAV_SEVERITY_WARNING
_INFO = mavlink.MAV_SEVERITY_INFO


class File(NamedTuple):
    """One of the files that there may be."""

    kind: Kind
    staged: bool


@dataclass(frozen=True, kw_only=True)
class Entry:
    """One line of a folder's list; `size` in bytes, None for a folder."""

    name: str
    size: int | None


FOLDERS = {"ref": Kind.REFERENCE, "ff": Kind.FEEDFORWARD}
FILES = {
    f"{folder}/{'staged' if staged else 'live'}.{folder}": File(kind, staged)
    for folder, kind in FOLDERS.items()
    for staged in (False, True)
}
"""By path without the first slash."""
_WHY = {
    UploadResult.BUSY: "an upload or a swap is under way",
    UploadResult.TOO_LARGE: "too large",
    UploadResult.BAD_REQUEST: "empty",
}


class BlobFiles:
    """Reads and writes by path.

    Parameters
    ----------
    text
        tells people. on_upload: is told what writing and removing brought about.
    """

    def __init__(
        self,
        *,
        store: ReferenceStore,
        upload: UploadReceiver,
        text: Callable[[int, str], None],
        on_upload: Callable[[list[ReceiverEvent], int], None],
    ) -> None:
        self.most_bytes = store.bank_bytes
        self._store = store
        self._upload = upload
        self._text = text
        self._on_upload = on_upload

    @staticmethod
    def find(path: str) -> File | None:
        """Return the file of this path, None where there never is one."""
        return FILES.get(path.lstrip("/"))

    def entries(self, path: str) -> list[Entry] | None:
        """Return what the folder holds, None where it is no folder."""
        folder = path.strip("/")
        if folder == "":
            return [Entry(name=name, size=None) for name in FOLDERS]
        if folder not in FOLDERS:
            return None
        found = []
        for name, file in FILES.items():
            data = self.read(file)
            if name.startswith(f"{folder}/") and data is not None:
                found.append(Entry(name=name.partition("/")[2], size=len(data)))
        return found

    def read(self, file: File) -> bytes | None:
        """Its bytes as they are on board, None where there are none."""
        if not file.staged:
            return self._store.live(file.kind)
        kind, _ = self._upload.staged()
        return self._store.staged(file.kind) if kind == file.kind else None

    def write(self, path: str, data: bytes, now_us: int) -> bool:
        """Whether `data` is staged now; where it is not, nothing of it is kept and a text says why."""
        file = self.find(path)
        assert file is not None, "only files that there may be are opened"
        result, verdict, events = self._upload.put(file.kind, data, now_us)
        self._on_upload(events, now_us)
        name = path.rpartition("/")[2]
        if result is UploadResult.OK:
            self._text(_INFO, f"{name} accepted: {len(data)} bytes")
            return True
        if verdict is None or verdict.ok:
            self._text(_WARNING, f"{name} refused: {_WHY.get(result, result.name.lower())}")
        else:
            node = "" if verdict.node is None else f" at node {verdict.node}"
            self._text(_WARNING, f"{name} refused{node}:")
            self._text(_WARNING, verdict.message)
        return False

    def broken(self, path: str, held: int, size: int) -> None:
        """Report a file that was closed with bytes missing."""
        name = path.rpartition("/")[2]
        self._text(_WARNING, f"{name} refused: {size - held} of {size} bytes missing")

    def remove(self, file: File, now_us: int) -> bool:
        """Whether there was a staged file, which is no more."""
        result, events = self._upload.remove(file.kind, now_us)
        self._on_upload(events, now_us)
        return result is UploadResult.OK
