"""Transition table of the sender of an upload."""

from __future__ import annotations

from enum import Enum, auto
from typing import NamedTuple

from trimtab.protocol.upload.transfer import Table


class SenderState(Enum):
    """States of the sender."""

    OPENING = auto()
    """The blob is announced, and no answer has arrived."""
    SENDING = auto()
    CHECKING = auto()
    """The blob or the tick was refused, and the verdict with the reason has not arrived."""
    COMMITTING = auto()
    DONE = auto()
    """The blob is live, its swap is agreed, or it is staged and no commit was requested."""
    FAILED = auto()
    """The upload failed; `UploadSender.reason` explains it."""


class Event(Enum):
    """Events of the sender."""

    RECEIVING = auto()
    STAGED = auto()
    """The blob is accepted, and a commit was requested."""
    STAGED_ONLY = auto()
    """The blob is accepted, and no commit was requested."""
    REFUSED = auto()
    REFUSAL_VERDICT = auto()
    """The verdict with the reason of a refusal arrived."""
    LIVE = auto()
    SCHEDULED = auto()
    """The blob takes over at the requested tick."""
    NOT_TAKEN = auto()
    """The blob cannot take over at the requested tick; the verdict gives the reason."""
    FORGOTTEN = auto()
    """The receiver does not know the blob: it restarted or discarded the upload."""
    CORRUPT = auto()
    """The received bytes did not match the digest and were discarded."""
    TOO_MANY_RESTARTS = auto()
    """FORGOTTEN or CORRUPT, after the greatest number of restarts."""
    REJECTED = auto()
    """The receiver does not accept blobs of this size or kind."""
    BUSY = auto()
    """A commit is not possible now."""
    OVERDUE = auto()
    """An answer has not arrived in time."""
    SILENCE = auto()
    """There was no progress for `patience_us`."""
    CANCEL = auto()


class Action(Enum):
    """Actions of the transitions."""

    NOTHING = auto()
    NOTE_HELD = auto()
    RESTART = auto()
    ANNOUNCE = auto()
    COMMIT = auto()
    FAIL_REFUSED = auto()
    FAIL_RESTARTS = auto()
    FAIL_REJECTED = auto()
    FAIL_BUSY = auto()
    FAIL_SILENCE = auto()
    ABORT = auto()


class Move(NamedTuple):
    """A transition: the next state and the action."""

    state: SenderState
    action: Action


class Refusal(NamedTuple):
    """An ignored event: the state does not change."""

    reason: str


Entry = Move | Refusal
_S, _E, _A = SenderState, Event, Action
_OVER = Refusal("the upload is over")

_IN_PROGRESS: dict[Event, Entry] = {
    _E.RECEIVING: Move(_S.SENDING, _A.NOTE_HELD),
    _E.STAGED: Move(_S.COMMITTING, _A.COMMIT),
    _E.STAGED_ONLY: Move(_S.DONE, _A.NOTHING),
    _E.REFUSED: Move(_S.CHECKING, _A.NOTHING),
    _E.REFUSAL_VERDICT: Move(_S.FAILED, _A.FAIL_REFUSED),
    _E.LIVE: Move(_S.DONE, _A.NOTHING),
    _E.SCHEDULED: Move(_S.DONE, _A.NOTHING),
    _E.NOT_TAKEN: Refusal("no commit was requested"),
    _E.FORGOTTEN: Move(_S.OPENING, _A.RESTART),
    _E.CORRUPT: Move(_S.OPENING, _A.RESTART),
    _E.TOO_MANY_RESTARTS: Move(_S.FAILED, _A.FAIL_RESTARTS),
    _E.REJECTED: Move(_S.FAILED, _A.FAIL_REJECTED),
    _E.BUSY: Refusal("no commit was requested"),
    _E.SILENCE: Move(_S.FAILED, _A.FAIL_SILENCE),
    _E.CANCEL: Move(_S.FAILED, _A.ABORT),
}
"""Entries of every state in progress: the receiver's state overrides the sender's."""

TABLE: Table[SenderState, Event, Entry] = Table(
    SenderState,
    Event,
    {
        _S.OPENING: {
            **_IN_PROGRESS,
            _E.FORGOTTEN: Refusal("already announced again"),
            _E.OVERDUE: Move(_S.OPENING, _A.ANNOUNCE),
        },
        _S.SENDING: {**_IN_PROGRESS, _E.OVERDUE: Move(_S.SENDING, _A.ANNOUNCE)},
        _S.CHECKING: {
            **_IN_PROGRESS,
            _E.RECEIVING: Refusal("an answer from before the last chunk"),
            _E.OVERDUE: Move(_S.CHECKING, _A.ANNOUNCE),
        },
        _S.COMMITTING: {
            **_IN_PROGRESS,
            _E.RECEIVING: Refusal("an answer from before the last chunk"),
            _E.STAGED: Refusal("the commit was sent"),
            _E.BUSY: Move(_S.FAILED, _A.FAIL_BUSY),
            _E.NOT_TAKEN: Move(_S.CHECKING, _A.NOTHING),
            _E.OVERDUE: Move(_S.COMMITTING, _A.COMMIT),
        },
        _S.DONE: dict.fromkeys(Event, _OVER),
        _S.FAILED: dict.fromkeys(Event, _OVER),
    },
)
