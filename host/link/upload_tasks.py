"""Tasks that upload a blob and make it live."""

from __future__ import annotations

from collections.abc import Generator
from typing import Any

from trimtab.host.base.errors import LinkError, Refused
from trimtab.host.link.client import Client
from trimtab.host.link.tasks import RETRY_US, Task
from trimtab.protocol import messages as m
from trimtab.protocol.blobs import Blob
from trimtab.protocol.messages import Message, UploadState
from trimtab.protocol.upload import SenderState, UploadSender
from trimtab.protocol.upload.transfer import tag_of


class SendBlob(Task):
    """Upload a blob. The result is the UploadSender. Raises Refused, or LinkError if no answer comes."""

    wants = (m.UploadStatus, m.UploadVerdict)

    def __init__(self, blob: bytes, kind: int, *, what: str) -> None:
        super().__init__()
        self._blob = blob
        self._kind = kind
        self._what = what

    def begin(self, client: Client, now_us: int) -> None:
        self.sender = UploadSender(self._blob, self._kind, chunk_bytes=client.chunk_bytes)
        self._pump(client, now_us)

    def receive(self, client: Client, message: Message, now_us: int) -> None:
        if self.sender.receive(message, now_us):
            self._pump(client, now_us)

    def advance(self, client: Client, now_us: int) -> None:
        self.sender.advance(now_us)
        self._pump(client, now_us)

    def _pump(self, client: Client, now_us: int) -> None:
        for message in self.sender.send(now_us):
            client.send(message)
        if self.sender.state is SenderState.DONE:
            self.finish(self.sender)
        elif self.sender.over:
            if self.sender.silent:
                raise LinkError(f"{self._what}: {self.sender.reason}; check the link and send it again")
            raise Refused(f"{self._what}: {self.sender.reason.strip()}")
        else:
            self.deadline_us = self.sender.next_deadline_us() or now_us


class AbortBlob(Task):
    """Cancel an upload. The task ends when the vehicle confirms, or after the last attempt."""

    wants = (m.UploadStatus,)

    def __init__(self, sender: UploadSender, attempts: int = 5) -> None:
        super().__init__()
        self._sender = sender
        self._attempts = attempts
        self._messages: list[Message] = []

    def begin(self, client: Client, now_us: int) -> None:
        self._sender.cancel(now_us)
        self._messages = self._sender.send(now_us)
        self.advance(client, now_us)

    def advance(self, client: Client, now_us: int) -> None:
        if self._attempts == 0 or not self._messages:  # without messages the upload was already over
            self.finish()
            return
        self._attempts -= 1
        for message in self._messages:
            client.send(message)
        self.deadline_us = now_us + RETRY_US

    def receive(self, client: Client, message: Message, now_us: int) -> None:
        assert isinstance(message, m.UploadStatus)
        if message.tag == tag_of(self._sender.digest) and message.state in (
            UploadState.IDLE,
            UploadState.LIVE,
        ):
            self.finish()


def make_live(blob: Blob, what: str) -> Generator[Task, Any, UploadSender]:
    """Make a blob live and return its sender. For session scripts. At Ctrl-C, cancel the upload on board."""
    task = SendBlob(blob.to_bytes(), blob.KIND, what=what)
    try:
        return (yield task)
    except KeyboardInterrupt:
        yield AbortBlob(task.sender)
        raise
