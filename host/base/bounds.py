"""Bounds of what is read from files: the one table of them, which `docs/reference/bounds.md` is made from.

A reader checks the size before the content: what a file declares, and then what is really there, since a
declared size may be false. Beyond a bound, it refuses the file in one line.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any


@dataclass(frozen=True, kw_only=True)
class Bound:
    """The most of something that a file may hold.

    files: which files. what: what is bounded. unit: of `limit`. why: reason for the limit. remedy: what to do
    with a file beyond it. per_byte: the limit for each byte of the file, where that is more than `limit`; so
    large files may hold more.
    """

    files: str
    what: str
    limit: int
    unit: str
    why: str
    remedy: str
    per_byte: float = 0.0

    def limit_of(self, file_bytes: int) -> int:
        """Return the limit for a file of this size."""
        return max(self.limit, int(self.per_byte * file_bytes))

    def problem(self, amount: int | None = None, *, limit: int | None = None) -> str:
        """Return the problem and its remedy, for a message that names the file.

        amount: how much there is, if it is known. limit: of this file.
        """
        count = "" if amount is None else f"{amount} {self.unit}, "
        most = self.limit if limit is None else limit
        return f"{self.what}: {count}more than {most} {self.unit}; {self.remedy}"


MIB = 1 << 20
_DAMAGED = "it is damaged or made to exhaust memory"

TOML_BYTES = Bound(
    files="vehicle, route, world, controller, model, map (.toml)",
    what="size of the file",
    limit=MIB // 2,
    unit="bytes",
    why="2000 waypoints take 50 kB, the covariance of 60 parameters 90 kB",
    remedy="remove what does not belong to it",
)
TOML_DEPTH = Bound(
    files=TOML_BYTES.files,
    what="parts of a key, or tables and lists inside each other",
    limit=16,
    unit="levels",
    why="no file of these needs more than 6",
    remedy="correct the key or the brackets",
)
WAYPOINTS = Bound(
    files="route (.toml)",
    what="waypoints of all laps",
    limit=2000,
    unit="waypoints",
    why="a route lasts at most 500 s; 4 waypoints a second are more than a vehicle can follow",
    remedy="leave out waypoints or laps",
)
RECORD_BYTES = Bound(
    files="record of an artefact (.json)",
    what="size of the file",
    limit=16 * MIB,
    unit="bytes",
    why="a record of a plan has some kB, a report grows with its flights",
    remedy="make the artefact again",
)
BLOB_BYTES = Bound(
    files="reference, feed-forward (.ref, .ff)",
    what="size of the file",
    limit=MIB,
    unit="bytes",
    why="four times what a vehicle stores",
    remedy="plan with fewer nodes",
)
WEIGHTS_BYTES = Bound(
    files="weights of a model (.npz)",
    what="size of the file",
    limit=MIB,
    unit="bytes",
    why="the largest network has 2435 weights, 20 kB",
    remedy="learn the model anew",
)
LOG_RECORD_BYTES = Bound(
    files="flight log (.mcap)",
    what="size of a record or of the content of a chunk",
    limit=64 * MIB,
    unit="bytes",
    why="Trimtab writes chunks of 64 KiB; other writers use up to some MiB",
    remedy=f"{_DAMAGED}, so get it again from its source",
)
LOG_CONTENT = Bound(
    files="flight log (.mcap)",
    what="content of all chunks together",
    limit=128 * MIB,
    unit="bytes",
    per_byte=8.0,
    why="flight logs are compressed 1.7 times",
    remedy=f"{_DAMAGED}, so get it again from its source",
)
LOG_MESSAGES = Bound(
    files="flight log (.mcap)",
    what="messages",
    limit=500_000,
    unit="messages",
    per_byte=0.1,
    why="flight logs have 11 messages in 1000 bytes",
    remedy=f"{_DAMAGED}, so get it again from its source",
)
CSV_LINE = Bound(
    files="CSV log",
    what="length of a row",
    limit=MIB,
    unit="characters",
    why="a row of 10000 numbers has 250 kB",
    remedy="end each row with a line break",
)
CSV_COLUMNS = Bound(
    files="CSV log",
    what="columns",
    limit=10_000,
    unit="columns",
    why="200 markers of motion capture take 600, a log of all variables of a vehicle 1000",
    remedy="leave out columns",
)
ULOG_FIELDS = Bound(
    files="ULog",
    what="values of one message, nested formats and arrays included",
    limit=65_535,
    unit="values",
    why="the format counts the bytes of a message with 16 bits",
    remedy=f"a definition {_DAMAGED.removeprefix('it ')}, so copy it from the vehicle again",
)
ULOG_ALL_FIELDS = Bound(
    files="ULog",
    what="values of one message of each topic together",
    limit=200_000,
    unit="values",
    why="PX4 logs at most 255 topics; all of a flight take 4000 values, the largest topic 88",
    remedy=ULOG_FIELDS.remedy,
)
ULOG_DEPTH = Bound(
    files="ULog",
    what="formats inside each other",
    limit=16,
    unit="levels",
    why="PX4 nests formats once",
    remedy=ULOG_FIELDS.remedy,
)
DATAFLASH_MESSAGES = Bound(
    files="DataFlash log (.bin)",
    what="messages",
    limit=500_000,
    unit="messages",
    per_byte=0.1,
    why="ArduPilot's logs have a message in 25 to 50 bytes",
    remedy=f"{_DAMAGED}, so download it again",
)
DATAFLASH_JUNK = Bound(
    files="DataFlash log (.bin)",
    what="bytes that belong to no message",
    limit=4 * MIB,
    unit="bytes",
    why="messages fill a log but for its end",
    remedy=f"{_DAMAGED}, so download it again",
)
USD_RECORDS = Bound(
    files="Crazyflie uSD log",
    what="records",
    limit=500_000,
    unit="records",
    per_byte=0.1,
    why="a record has 10 bytes for its type and time, before the first number",
    remedy=f"{_DAMAGED}, so copy it from the card again",
)
BAG_CHUNK_BYTES = Bound(
    files="rosbag (.bag, .mcap, .db3)",
    what="content of a chunk or a compressed message",
    limit=64 * MIB,
    unit="bytes",
    why="writers use 768 KiB to 4 MiB, more only for a single message, such as an image of 36 MB",
    remedy="write the bag again with smaller chunks",
)
BAG_CONTENT = Bound(
    files=BAG_CHUNK_BYTES.files,
    what="all content that is decompressed",
    limit=512 * MIB,
    unit="bytes",
    per_byte=16.0,
    why="numbers and images of sensors are noisy, and noise cannot be compressed",
    remedy=f"{_DAMAGED}, so record it again",
)
BAG_METADATA_BYTES = Bound(
    files="rosbag (a folder)",
    what="size of metadata.yaml",
    limit=MIB // 2,
    unit="bytes",
    why="a topic takes about 1 kB",
    remedy="run ros2 bag reindex, or record fewer topics",
)
BAG_STEPS = Bound(
    files="rosbag (.db3)",
    what="steps of SQLite's machine",
    limit=50_000_000,
    unit="steps",
    per_byte=4.0,
    why="counting the messages takes some 20 steps for each of them",
    remedy=f"{_DAMAGED}, so record it again",
)
BAG_DEFINITION_BYTES = Bound(
    files="rosbag",
    what="different definitions of messages together",
    limit=2 * MIB,
    unit="bytes",
    why="a definition of ROS, with all that it uses, takes some kB, and topics share them",
    remedy="record fewer topics",
)
BAG_ARRAYS = Bound(
    files="rosbag",
    what="messages inside a message, by the product of the fixed arrays of a definition",
    limit=65_536,
    unit="messages",
    why="arrays of fixed length hold numbers, hardly ever messages",
    remedy=f"{_DAMAGED}, so record it again",
)

BOUNDS: tuple[Bound, ...] = (
    TOML_BYTES, TOML_DEPTH, WAYPOINTS, RECORD_BYTES, BLOB_BYTES, WEIGHTS_BYTES, LOG_RECORD_BYTES, LOG_CONTENT,
    LOG_MESSAGES, CSV_LINE, CSV_COLUMNS, ULOG_FIELDS, ULOG_ALL_FIELDS, ULOG_DEPTH, DATAFLASH_MESSAGES,
    DATAFLASH_JUNK, USD_RECORDS, BAG_CHUNK_BYTES, BAG_CONTENT, BAG_METADATA_BYTES, BAG_STEPS,
    BAG_DEFINITION_BYTES, BAG_ARRAYS,
)  # fmt: skip
"""Every bound, in the order of the page."""


class TooLarge(ValueError):
    """A file holds more than a bound. The text has the problem and the remedy, without the file's name."""


def read_bounded(path: Path, bound: Bound) -> bytes:
    """Return the content of a file. Raises TooLarge beyond the bound, and OSError."""
    with path.open("rb") as file:
        content = file.read(bound.limit + 1)
    if len(content) > bound.limit:
        raise TooLarge(bound.problem())
    return content


def read_text(path: Path, bound: Bound) -> str:
    """Return the text of a UTF-8 file, with newlines alone between lines. Raises as `read_bounded`."""
    return read_bounded(path, bound).decode("utf-8").replace("\r\n", "\n").replace("\r", "\n")


def read_json(path: Path) -> Any:
    """Return what a JSON file holds. Raises ValueError, also for TooLarge or deep nesting, and OSError."""
    try:
        return json.loads(read_bounded(path, RECORD_BYTES))
    except RecursionError:
        raise ValueError("nested too deeply") from None
