"""Transition table of the receiver of an upload."""

from __future__ import annotations

from enum import Enum, auto
from typing import NamedTuple

from trimtab.protocol.messages import UploadResult, UploadState
from trimtab.protocol.upload.transfer import Table


class Event(Enum):
    """Events. SAME concerns the current blob, LIVE a live blob, OTHER any other blob."""

    BEGIN_SAME = auto()
    BEGIN_LIVE = auto()
    BEGIN_OTHER = auto()
    BEGIN_BAD_KIND = auto()
    BEGIN_BAD_REQUEST = auto()
    BEGIN_TOO_LARGE = auto()
    CHUNK_NEW = auto()
    CHUNK_HELD = auto()
    CHUNK_FOREIGN = auto()
    CHECK_PASSED = auto()
    CHECK_REFUSED = auto()
    CORRUPT = auto()
    COMMIT_SAME = auto()
    COMMIT_BUSY = auto()
    COMMIT_LIVE = auto()
    COMMIT_OTHER = auto()
    COMMIT_AT = auto()
    """A commit at a tick to which the owner agrees."""
    COMMIT_AT_REFUSED = auto()
    DUE = auto()
    """The agreed tick has been reached."""
    CALLED_OFF = auto()
    """The vehicle no longer flies the reference that the agreement was for."""
    ABORT_SAME = auto()
    ABORT_OTHER = auto()


class Action(Enum):
    """Actions of the transitions."""

    BEGIN = auto()
    KEEP = auto()
    REPORT = auto()
    REPORT_SOON = auto()
    REQUEST_BEGIN = auto()
    STAGE = auto()
    REFUSE = auto()
    DROP = auto()
    COMMIT = auto()
    REFUSE_COMMIT = auto()
    ANSWER_BUSY = auto()
    ANSWER_LIVE = auto()
    DISCARD = auto()
    CHECK_AGAIN = auto()


class Move(NamedTuple):
    """A transition: the next state and the action."""

    state: UploadState
    action: Action


class Refusal(NamedTuple):
    """A refused event: the state does not change. `result` is the answer; None sends no answer."""

    result: UploadResult | None
    reason: str


Entry = Move | Refusal
STATES = (
    UploadState.IDLE,
    UploadState.RECEIVING,
    UploadState.STAGED,
    UploadState.REFUSED,
    UploadState.SCHEDULED,
)
"""States of the receiver. LIVE is not one of them: it only answers requests about a live blob."""

_S, _E, _A, _R = UploadState, Event, Action, UploadResult
_UNKNOWN_BLOB = Refusal(_R.UNKNOWN, "unknown blob")
_NO_BLOB = Refusal(None, "no current blob")
_COMPLETE = Refusal(None, "all chunks are held already")
_INCOMPLETE = Refusal(_R.BAD_REQUEST, "chunks are missing")
_FOREIGN = Refusal(None, "a chunk of another blob")
_NOT_AGREED = Refusal(None, "no tick is agreed")


def _everywhere(state: UploadState) -> dict[Event, Entry]:
    """Return the entries that are the same in every state."""
    return {
        _E.BEGIN_LIVE: Move(state, _A.ANSWER_LIVE),
        _E.BEGIN_OTHER: Move(_S.RECEIVING, _A.BEGIN),
        _E.BEGIN_BAD_KIND: Refusal(_R.BAD_KIND, "no such kind of blob"),
        _E.BEGIN_BAD_REQUEST: Refusal(_R.BAD_REQUEST, "empty, or another chunk size"),
        _E.BEGIN_TOO_LARGE: Refusal(_R.TOO_LARGE, "larger than the capacity"),
        _E.COMMIT_LIVE: Move(state, _A.ANSWER_LIVE),
        _E.COMMIT_OTHER: _UNKNOWN_BLOB,
        _E.ABORT_OTHER: _UNKNOWN_BLOB,
        _E.DUE: _NOT_AGREED,
        _E.CALLED_OFF: _NOT_AGREED,
    }


TABLE: Table[UploadState, Event, Entry] = Table(
    STATES,
    Event,
    {
        _S.IDLE: {
            **_everywhere(_S.IDLE),
            _E.BEGIN_SAME: _NO_BLOB,
            _E.CHUNK_NEW: _NO_BLOB,
            _E.CHUNK_HELD: _NO_BLOB,
            _E.CHUNK_FOREIGN: Move(_S.IDLE, _A.REQUEST_BEGIN),
            _E.CHECK_PASSED: _NO_BLOB,
            _E.CHECK_REFUSED: _NO_BLOB,
            _E.CORRUPT: _NO_BLOB,
            _E.COMMIT_SAME: _NO_BLOB,
            _E.COMMIT_BUSY: _NO_BLOB,
            _E.COMMIT_AT: _NO_BLOB,
            _E.COMMIT_AT_REFUSED: _NO_BLOB,
            _E.ABORT_SAME: _NO_BLOB,
        },
        _S.RECEIVING: {
            **_everywhere(_S.RECEIVING),
            _E.BEGIN_SAME: Move(_S.RECEIVING, _A.REPORT),
            _E.CHUNK_NEW: Move(_S.RECEIVING, _A.KEEP),
            _E.CHUNK_HELD: Move(_S.RECEIVING, _A.REPORT_SOON),
            _E.CHUNK_FOREIGN: _FOREIGN,
            _E.CHECK_PASSED: Move(_S.STAGED, _A.STAGE),
            _E.CHECK_REFUSED: Move(_S.REFUSED, _A.REFUSE),
            _E.CORRUPT: Move(_S.IDLE, _A.DROP),
            _E.COMMIT_SAME: _INCOMPLETE,
            _E.COMMIT_BUSY: _INCOMPLETE,
            _E.COMMIT_AT: _INCOMPLETE,
            _E.COMMIT_AT_REFUSED: _INCOMPLETE,
            _E.ABORT_SAME: Move(_S.IDLE, _A.DISCARD),
        },
        _S.STAGED: {
            **_everywhere(_S.STAGED),
            _E.BEGIN_SAME: Move(_S.STAGED, _A.REPORT),
            _E.CHUNK_NEW: _COMPLETE,
            _E.CHUNK_HELD: Move(_S.STAGED, _A.REPORT_SOON),
            _E.CHUNK_FOREIGN: _FOREIGN,
            _E.CHECK_PASSED: _COMPLETE,
            _E.CHECK_REFUSED: Move(_S.REFUSED, _A.REFUSE),
            _E.CORRUPT: _COMPLETE,
            _E.COMMIT_SAME: Move(_S.IDLE, _A.COMMIT),
            _E.COMMIT_BUSY: Refusal(
                _R.BUSY, "the vehicle is armed or flying; it swaps a blob only at an agreed tick"
            ),
            _E.COMMIT_AT: Move(_S.SCHEDULED, _A.REPORT),
            _E.COMMIT_AT_REFUSED: Move(_S.STAGED, _A.REFUSE_COMMIT),
            _E.ABORT_SAME: Move(_S.IDLE, _A.DISCARD),
        },
        _S.REFUSED: {
            **_everywhere(_S.REFUSED),
            _E.BEGIN_SAME: Move(_S.RECEIVING, _A.CHECK_AGAIN),
            _E.CHUNK_NEW: _COMPLETE,
            _E.CHUNK_HELD: Move(_S.REFUSED, _A.REPORT_SOON),
            _E.CHUNK_FOREIGN: _FOREIGN,
            _E.CHECK_PASSED: _COMPLETE,
            _E.CHECK_REFUSED: _COMPLETE,
            _E.CORRUPT: _COMPLETE,
            _E.COMMIT_SAME: Move(_S.REFUSED, _A.REPORT),
            _E.COMMIT_BUSY: Move(_S.REFUSED, _A.REPORT),
            _E.COMMIT_AT: Move(_S.REFUSED, _A.REPORT),
            _E.COMMIT_AT_REFUSED: Move(_S.REFUSED, _A.REPORT),
            _E.ABORT_SAME: Move(_S.IDLE, _A.DISCARD),
        },
        _S.SCHEDULED: {
            **_everywhere(_S.SCHEDULED),
            _E.BEGIN_SAME: Move(_S.SCHEDULED, _A.REPORT),
            _E.CHUNK_NEW: _COMPLETE,
            _E.CHUNK_HELD: Move(_S.SCHEDULED, _A.REPORT_SOON),
            _E.CHUNK_FOREIGN: _FOREIGN,
            _E.CHECK_PASSED: _COMPLETE,
            _E.CHECK_REFUSED: _COMPLETE,
            _E.CORRUPT: _COMPLETE,
            _E.COMMIT_SAME: Move(_S.IDLE, _A.COMMIT),
            _E.COMMIT_BUSY: Move(_S.STAGED, _A.ANSWER_BUSY),
            _E.COMMIT_AT: Move(_S.SCHEDULED, _A.REPORT),
            _E.COMMIT_AT_REFUSED: Move(_S.STAGED, _A.REFUSE_COMMIT),
            _E.DUE: Move(_S.IDLE, _A.COMMIT),
            _E.CALLED_OFF: Move(_S.STAGED, _A.REPORT),
            _E.ABORT_SAME: Move(_S.IDLE, _A.DISCARD),
        },
    },
)
