"""The tables behind both ends of an upload."""

from __future__ import annotations

import pytest

from trimtab.protocol.messages import UploadState
from trimtab.protocol.upload import SenderState
from trimtab.protocol.upload import receiver_table as receiver
from trimtab.protocol.upload import sender_table as sender
from trimtab.protocol.upload.transfer import Table


@pytest.mark.parametrize(
    ("table", "states", "events"),
    [
        (receiver.TABLE, receiver.STATES, receiver.Event),
        (sender.TABLE, SenderState, sender.Event),
    ],
)
def test_every_state_and_event_has_a_transition_or_a_refusal_with_a_reason(table, states, events) -> None:
    for state in states:
        for event in events:
            entry = table(state, event)
            if isinstance(entry, receiver.Refusal | sender.Refusal):
                assert entry.reason
            else:
                assert entry.state in states


def test_a_table_with_a_gap_is_refused_when_built() -> None:
    rows = {state: dict.fromkeys(receiver.Event, "x") for state in receiver.STATES}
    del rows[UploadState.STAGED][receiver.Event.CORRUPT]
    with pytest.raises(ValueError, match="STAGED has no entry for CORRUPT"):
        Table(receiver.STATES, receiver.Event, rows)


def test_receiver_commits_only_from_staged_and_stages_only_after_a_passed_check() -> None:
    committing = set()
    for state in receiver.STATES:
        for event in receiver.Event:
            entry = receiver.TABLE(state, event)
            if isinstance(entry, receiver.Move) and entry.action is receiver.Action.COMMIT:
                committing.add((state, event))
            if isinstance(entry, receiver.Move) and entry.state is UploadState.STAGED is not state:
                # A commit that was agreed and is called off leaves what was staged before.
                assert event is receiver.Event.CHECK_PASSED or state is UploadState.SCHEDULED
    assert committing == {
        (UploadState.STAGED, receiver.Event.COMMIT_SAME),
        (UploadState.SCHEDULED, receiver.Event.COMMIT_SAME),
        (UploadState.SCHEDULED, receiver.Event.DUE),
    }


def test_sender_that_is_over_stays_over() -> None:
    for state in (SenderState.DONE, SenderState.FAILED):
        assert all(isinstance(sender.TABLE(state, event), sender.Refusal) for event in sender.Event)
