"""The form of a check."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Status = Literal["ok", "note", "problem"]


@dataclass(frozen=True, kw_only=True)
class Check:
    """The result of a check. note: something is absent or slower. problem: a part of Trimtab fails.

    remedy: what to do; None where nothing is to be done or `text` says it.
    """

    name: str
    status: Status
    text: str
    remedy: str | None = None

    def to_line(self) -> str:
        """Return the check as a line."""
        end = "" if self.remedy is None else f"; {self.remedy}"
        return f"{self.status:7} {self.name}: {' '.join((self.text + end).split())}"
