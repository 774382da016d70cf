"""Verifiers that were weakened on purpose. A study of attacks that catches none of them proves nothing."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from typing import Any

from trimtab.protocol.signing import Verdict, Verifier
from trimtab.sitl.studies.attack.frames import KEY


class NoReplayWindow(Verifier):
    """Accepts a message again."""

    def check(self, message: bytes) -> Verdict:
        verdict = super().check(message)
        return Verdict.ACCEPTED if verdict is Verdict.REPLAYED else verdict


class NoTimestampCheck(Verifier):
    """Accepts every timestamp."""

    def check(self, message: bytes) -> Verdict:
        verdict = super().check(message)
        refused = (Verdict.REPLAYED, Verdict.TOO_OLD, Verdict.TOO_NEW)
        return Verdict.ACCEPTED if verdict in refused else verdict


class TruncatedSignature(Verifier):
    """Compares the first byte of a signature only."""

    def check(self, message: bytes) -> Verdict:
        verdict = super().check(message)
        if verdict is not Verdict.BAD_SIGNATURE:
            return verdict
        digest = hashlib.sha256(KEY.secret + message[:-6]).digest()
        return Verdict.ACCEPTED if digest[0] == message[-6] else verdict


class StoresBeforeCheck(Verifier):
    """Stores the newest timestamp of a stream before it checks the signature, as pymavlink 2.4.50 does."""

    def __init__(self, *arguments: Any, **keywords: Any) -> None:
        super().__init__(*arguments, **keywords)
        self._stored: dict[tuple[int, int, int], int] = {}

    def check(self, message: bytes) -> Verdict:
        if message[2] & 1:
            stream, timestamp = (
                (message[5], message[6], message[-13]),
                int.from_bytes(message[-12:-6], "little"),
            )
            if timestamp <= self._stored.get(stream, 0):
                return Verdict.TOO_OLD
            self._stored[stream] = timestamp
        return super().check(message)


class AcceptsUnsigned(Verifier):
    """Accepts messages without a signature."""

    def check(self, message: bytes) -> Verdict:
        verdict = super().check(message)
        return Verdict.ACCEPTED if verdict is Verdict.UNSIGNED else verdict


MUTANTS: Mapping[str, type[Verifier]] = {
    "no replay window": NoReplayWindow,
    "no timestamp check": NoTimestampCheck,
    "signature of one byte": TruncatedSignature,
    "timestamp stored before the check": StoresBeforeCheck,
    "unsigned messages accepted": AcceptsUnsigned,
}
"""Weakened verifiers by name."""
