"""Times of messages in the file: nanoseconds, as readers of MCAP expect, in whole microseconds.

Older logs hold microseconds in their place. The entry `time_unit` of a log's metadata tells the two apart.
Everywhere else, times are microseconds.
"""

from __future__ import annotations

from collections.abc import Mapping

TIME_UNIT = "time_unit"
"""Metadata entry with the unit of a log's times."""
NANOSECONDS = "ns"
"""Its value in every log that is written now."""
NS_PER_US = 1000
LAST_US = (2**64 - 1) // NS_PER_US
"""Latest time that the file can hold."""


def file_units_per_us(metadata: Mapping[str, str]) -> int:
    """Return how many units of a log's times make a microsecond, given the metadata of the log."""
    return NS_PER_US if metadata.get(TIME_UNIT) == NANOSECONDS else 1
