"""Reader of a log that is being written."""

from __future__ import annotations

from io import RawIOBase
from pathlib import Path
from types import TracebackType
from typing import Self, cast

from trimtab.host.base.parts import PartState
from trimtab.host.log.errors import LogError, unreadable
from trimtab.host.log.mcap_file import MAGIC
from trimtab.host.log.scan import Entry, Scan, take_grown
from trimtab.host.log.unfinished import unfinished_logs


class LogFollower:
    """Messages of the log at `path` as its writer adds them, chunk by chunk. Close it at the end.

    `content` holds what was read so far, without the messages that `poll` returned. The log need not exist
    yet. A log that is being written comes before what an interrupted writer left, and both come before a
    closed log of the same name.
    """

    def __init__(self, path: Path) -> None:
        self.content = Scan(path=path, id="", size=0)
        self._path = self._source = path
        self._file: RawIOBase | None = None
        self._rest = b""
        self._begun = False

    @property
    def ended(self) -> bool:
        """Whether the writer has closed the log."""
        return self.content.whole

    def poll(self) -> list[Entry]:
        """Return the messages that were written since the last call.

        Raises LogError if the file is no log, is damaged or cannot be read.
        """
        try:
            if self._file is None:
                self._source = _newest(self._path)
                self._file = cast(RawIOBase, open(self._source, "rb", buffering=0))  # noqa: SIM115
            while grown := self._file.read(1 << 20):
                self._take(grown)
        except FileNotFoundError:
            return []
        except OSError as error:
            raise unreadable(self._source, error) from error
        messages, self.content.messages = self.content.messages, []
        return messages

    def _take(self, grown: bytes) -> None:
        data = self._rest + grown
        if not self._begun:
            if len(data) < len(MAGIC):
                self._rest = data
                return
            if not data.startswith(MAGIC):
                raise LogError(f"{self._path}: is not an MCAP file; give the log that trimtab fly writes")
            data, self._begun = data[len(MAGIC) :], True
        self._rest = data[take_grown(self.content, data) :]

    def close(self) -> None:
        """Close the file."""
        if self._file is not None:
            self._file.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


def _newest(path: Path) -> Path:
    """Return the file to follow for the log `path`."""
    parts = sorted(unfinished_logs(path), key=lambda part: part.state is not PartState.WRITING)
    return parts[0].path if parts else path
