"""What the sender of an upload does on which event in which state."""

from __future__ import annotations

from enum import Enum, auto
from typing import NamedTuple

from trimtab.protocol.upload.transfer import Table


class SenderState(Enum):
    """How far the sender is."""

    OPENING = auto()
    """Announced, not yet answered."""
    SENDING = auto()
    CHECKING = auto()
    """All chunks arrived and were refused, or the tick was; the verdict with the reason is still to come."""
    COMMITTING = auto()
    DONE = auto()
    """Live, agreed to take over at a tick, or staged where no commit was wanted."""
    FAILED = auto()
    """`UploadSender.reason` says why."""


class Event(Enum):
    """What can happen."""

    RECEIVING = auto()
    STAGED = auto()
    """Accepted, and to be committed."""
    STAGED_ENOUGH = auto()
    """Accepted, and not to be committed."""
    REFUSED = auto()
    REFUSED_WHY = auto()
    """The verdict that says why it was refused."""
    LIVE = auto()
    SCHEDULED = auto()
    """It takes over at the tick asked for."""
    NOT_TAKEN = auto()
    """It cannot take over at that tick; the verdict says why."""
    FORGOTTEN = auto()
    """The receiver knows nothing of the blob: it was started anew, or gave up on a silence."""
    CORRUPT = auto()
    """What arrived did not make the digest, and was dropped."""
    HOPELESS = auto()
    """One of the two once too often."""
    REJECTED = auto()
    """Of a size or kind that the receiver does not take."""
    BUSY = auto()
    """A commit is not possible now."""
    OVERDUE = auto()
    """No answer for longer than an answer takes."""
    SILENCE = auto()
    """No progress for as long as patience lasts."""
    CANCEL = auto()


class Action(Enum):
    """What is done on the way."""

    NOTHING = auto()
    NOTE_HELD = auto()
    RESTART = auto()
    ASK = auto()
    COMMIT = auto()
    FAIL_REFUSED = auto()
    FAIL_HOPELESS = auto()
    FAIL_REJECTED = auto()
    FAIL_BUSY = auto()
    FAIL_SILENCE = auto()
    ABORT = auto()


class Move(NamedTuple):
    """A transition: the state afterwards and what is done."""

    state: SenderState
    action: Action


class Refusal(NamedTuple):
    """Nothing changes."""

    why: str


Entry = Move | Refusal
_S, _E, _A = SenderState, Event, Action
_OVER = Refusal("the upload is over")

_UNDER_WAY: dict[Event, Entry] = {
    _E.RECEIVING: Move(_S.SENDING, _A.NOTE_HELD),
    _E.STAGED: Move(_S.COMMITTING, _A.COMMIT),
    _E.STAGED_ENOUGH: Move(_S.DONE, _A.NOTHING),
    _E.REFUSED: Move(_S.CHECKING, _A.NOTHING),
    _E.REFUSED_WHY: Move(_S.FAILED, _A.FAIL_REFUSED),
    _E.LIVE: Move(_S.DONE, _A.NOTHING),
    _E.SCHEDULED: Move(_S.DONE, _A.NOTHING),
    _E.NOT_TAKEN: Refusal("no commit has been asked for"),
    _E.FORGOTTEN: Move(_S.OPENING, _A.RESTART),
    _E.CORRUPT: Move(_S.OPENING, _A.RESTART),
    _E.HOPELESS: Move(_S.FAILED, _A.FAIL_HOPELESS),
    _E.REJECTED: Move(_S.FAILED, _A.FAIL_REJECTED),
    _E.BUSY: Refusal("no commit has been asked for"),
    _E.SILENCE: Move(_S.FAILED, _A.FAIL_SILENCE),
    _E.CANCEL: Move(_S.FAILED, _A.ABORT),
}
"""The receiver's word decides, wherever the sender thought it was."""

TABLE: Table[SenderState, Event, Entry] = Table(
    SenderState,
    Event,
    {
        _S.OPENING: {
            **_UNDER_WAY,
            _E.FORGOTTEN: Refusal("announced again already"),
            _E.OVERDUE: Move(_S.OPENING, _A.ASK),
        },
        _S.SENDING: {**_UNDER_WAY, _E.OVERDUE: Move(_S.SENDING, _A.ASK)},
        _S.CHECKING: {
            **_UNDER_WAY,
            _E.RECEIVING: Refusal("an answer from before the last chunk"),
            _E.OVERDUE: Move(_S.CHECKING, _A.ASK),
        },
        _S.COMMITTING: {
            **_UNDER_WAY,
            _E.RECEIVING: Refusal("an answer from before the last chunk"),
            _E.STAGED: Refusal("the commit is under way"),
            _E.BUSY: Move(_S.FAILED, _A.FAIL_BUSY),
            _E.NOT_TAKEN: Move(_S.CHECKING, _A.NOTHING),
            _E.OVERDUE: Move(_S.COMMITTING, _A.COMMIT),
        },
        _S.DONE: dict.fromkeys(Event, _OVER),
        _S.FAILED: dict.fromkeys(Event, _OVER),
    },
)
