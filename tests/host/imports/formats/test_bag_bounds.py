"""Bags that make the library decompress, parse or compute without end are refused with the bound."""

from __future__ import annotations

import sqlite3
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.foreign.bag import write_bag
from tests.foreign.flight import in_axes, made_up
from tests.foreign.hostile import ros1_bag
from trimtab.host.base.bounds import (
    BAG_ARRAYS,
    BAG_CHUNK_BYTES,
    BAG_CONTENT,
    BAG_DEFINITION_BYTES,
    BAG_METADATA_BYTES,
    BAG_STEPS,
    Bound,
)
from trimtab.host.imports import ImportFormatError
from trimtab.host.imports.formats import bag_bounds, rosbag

pytest.importorskip("rosbags", reason="rosbags is not installed (extra logs)")

MIB = 1 << 20


def _ros1(path: Path, message: bytes, definition: str = "uint8[] data\n", *, lz4: bool = False) -> Path:
    """A bag with one message."""
    if lz4:
        from lz4.frame import compress
    else:
        from bz2 import compress
    path.write_bytes(ros1_bag(compress, "lz4" if lz4 else "bz2", message, definition))
    return path


def _write(folder: Path, kind: str) -> Path:
    path = folder / "bag"
    write_bag(in_axes(made_up().cut(slice(400, 420, 10)), "nwu", "flu"), path, kind)
    return path


def _database(folder: Path, change: Callable[[sqlite3.Connection], object]) -> Path:
    """A bag of rosbag2 in SQLite with a change to its database."""
    (path,) = _write(folder, "sqlite3").glob("*.db3")
    with sqlite3.connect(path) as connection:
        change(connection)
    connection.close()
    return path


ENDLESS = "WITH RECURSIVE c(x) AS (SELECT 1 UNION ALL SELECT x + 1 FROM c) SELECT x AS id, "


def _endless_definitions(database: sqlite3.Connection) -> None:
    database.execute("DROP TABLE message_definitions")
    database.execute(
        f"CREATE VIEW message_definitions AS {ENDLESS} 'a' AS topic_type, 'ros2msg' AS encoding, '' AS "
        "encoded_message_definition, '' AS type_description_hash FROM c WHERE x < 0"
    )


def _large_value(database: sqlite3.Connection) -> None:
    database.execute("UPDATE message_definitions SET encoded_message_definition = zeroblob(70000000)")


def _metadata(folder: Path) -> Path:
    _write(folder, "mcap")
    with (folder / "bag" / "metadata.yaml").open("a") as file:
        file.write("#" * MIB)
    return folder / "bag"


def _compressed_files(folder: Path) -> Path:
    """A bag whose file holds 70 frames of 32 MiB of zeros."""
    from backports import zstd

    (path,) = _write(folder, "mcap").glob("*.mcap")
    (folder / "bag" / f"{path.name}.zstd").write_bytes(zstd.compress(bytes(32 * MIB)) * 70)
    metadata = folder / "bag" / "metadata.yaml"
    text = metadata.read_text().replace(path.name, f"{path.name}.zstd")
    text = text.replace("compression_format: ''", "compression_format: zstd")
    metadata.write_text(text.replace("compression_mode: ''", "compression_mode: FILE"))
    return folder / "bag"


CASES: dict[str, tuple[Callable[[Path], Path], Bound]] = {
    "bz2": (lambda folder: _ros1(folder / "a.bag", bytes(65 * MIB)), BAG_CHUNK_BYTES),
    "lz4": (lambda folder: _ros1(folder / "a.bag", bytes(65 * MIB), lz4=True), BAG_CHUNK_BYTES),
    "long definition": (
        lambda folder: _ros1(folder / "a.bag", b"", "float64 x\n" + "# a comment\n" * 200_000),
        BAG_DEFINITION_BYTES,
    ),
    "arrays of messages": (
        lambda folder: _ros1(
            folder / "a.bag", b"",
            f"a/B[1000] x\n{'=' * 80}\nMSG: a/B\na/C[1000] x\n{'=' * 80}\nMSG: a/C\nuint8 x\n",
        ),
        BAG_ARRAYS,
    ),
    "endless view": (lambda folder: _database(folder, _endless_definitions), BAG_STEPS),
    "large metadata": (_metadata, BAG_METADATA_BYTES),
    "compressed file": (_compressed_files, BAG_CONTENT),
}  # fmt: skip


@pytest.mark.parametrize("case", CASES)
def test_bag_beyond_a_bound_is_refused_with_the_bound(case: str, tmp_path: Path) -> None:
    make, bound = CASES[case]
    path = make(tmp_path)
    with pytest.raises(ImportFormatError) as raised:
        rosbag.read(path)
    assert str(raised.value).startswith(f"{path.name}: ")
    assert bound.what in str(raised.value)
    assert "\n" not in str(raised.value)
    assert bag_bounds._open == []


def test_value_of_a_database_that_is_too_long_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ImportFormatError, match="not a whole bag"):
        rosbag.read(_database(tmp_path, _large_value))


def test_definition_that_topics_share_is_counted_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    flight = in_axes(made_up().cut(slice(400, 420, 10)), "nwu", "flu")
    write_bag(flight, tmp_path / "bag", "mcap", vehicles=3)
    counted: list[str] = []
    monkeypatch.setattr(bag_bounds.Budget, "spend_definition", lambda self, text: counted.append(text))
    rosbag.contents(tmp_path / "bag")
    assert len(counted) == 3
