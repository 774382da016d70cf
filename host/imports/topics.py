"""Foreign logs as topics with named fields on one clock."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Annotated

import numpy as np

from trimtab.host.imports.contents import Contents, topic
from trimtab.host.imports.recording import READABLE, ImportFormatError, first_of_equal
from trimtab.host.imports.tracks import Track


@dataclass(frozen=True, kw_only=True)
class Source:
    """Fields of one topic that hold a quantity, and the factor from their unit to SI."""

    topic: str
    fields: tuple[str, ...]
    factor: float = 1.0


@dataclass(frozen=True, kw_only=True, eq=False)
class Topic:
    """Rows of one topic: times, us, on the clock of the log, and columns by field."""

    t_us: Annotated[np.ndarray, "rows"]
    columns: Mapping[str, Annotated[np.ndarray, "rows"]]


@dataclass(frozen=True, kw_only=True, eq=False)
class TopicLog:
    """The topics of one file, the vehicle's parameters, and whether the file is damaged.

    `start_us` is the time of the first row on the clock of the log; tracks begin there.
    """

    name: str
    topics: Mapping[str, Topic]
    start_us: int
    duration_s: float
    parameters: Mapping[str, float] = field(default_factory=dict)
    damaged: bool = False

    def contents(self) -> Contents:
        """Return the topics in the order of their names."""
        return Contents(
            topics=tuple(
                topic(name, len(held.t_us), float(np.ptp(held.t_us)) * 1e-6)
                for name, held in sorted(self.topics.items())
                if len(held.t_us)
            ),
            duration_s=self.duration_s,
            notes=("the file is damaged; what could be read is used",) if self.damaged else (),
        )

    def has(self, source: Source) -> bool:
        """Return whether the file holds all fields of a source."""
        held = self.topics.get(source.topic)
        return held is not None and all(name in held.columns for name in source.fields)

    def first(self, sources: Sequence[Source]) -> Track | None:
        """Return the quantity from the first source that the file holds; None without any."""
        return next((self.needed(source) for source in sources if self.has(source)), None)

    def needed(self, source: Source) -> Track:
        """Return the quantity. Raises ImportFormatError if it is missing or has no finite values."""
        if not self.has(source):
            raise self.missing([source])
        held = self.topics[source.topic]
        with np.errstate(invalid="ignore"):  # damaged values; they are left out
            values = np.column_stack([held.columns[name] for name in source.fields]).astype(float)
        t_us = held.t_us - self.start_us
        sound = (np.abs(values) < READABLE).all(axis=1)
        order = np.argsort(t_us[sound], kind="stable")
        t_us, values = t_us[sound][order], values[sound][order]
        if len(t_us) < 2:
            raise ImportFormatError(
                f"{self.name}: fewer than two finite values of {source.topic}; log it again"
            )
        keep = first_of_equal(t_us)
        return Track(t_us=t_us[keep], values=values[keep] * source.factor)

    def missing(self, sources: Sequence[Source]) -> ImportFormatError:
        """Return the error that names the topics of every source."""
        wanted = " or ".join(dict.fromkeys(source.topic for source in sources))
        return ImportFormatError(f"{self.name}: no topic {wanted} with its values; log it and fly again")
