"""Whatever the values and maps: a recording or one error, and nothing else. tests/fuzz damages whole logs."""

from __future__ import annotations

import struct
import warnings
import zlib
from collections.abc import Iterator
from pathlib import Path

import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from trimtab.host.imports import ImportFormatError, formats
from trimtab.host.imports.airborne import airborne
from trimtab.host.imports.formats import FormatName, crazyflie_usd, nanobench
from trimtab.host.imports.plausible import consistent_parts
from trimtab.host.vehicle import ConfigurationError

USD_VARIABLES = tuple(
    variable
    for sources in (crazyflie_usd.POSITION[:1], crazyflie_usd.EULER[:1], crazyflie_usd.MOTORS[:1])
    for source in (*sources, *crazyflie_usd.RATE[:1], *crazyflie_usd.VOLTAGE[:1])
    for variable in source.variables
)
MORE = settings(max_examples=200, suppress_health_check=[HealthCheck.function_scoped_fixture])
MAP = """
world = "enu"
body = "flu"
time = "t"
position_m = ["x", "y", "z"]
euler = ["a", "b", "c"]
gyro = ["d", "e", "f"]
thrust_n = "T"
"""


@pytest.fixture(autouse=True)
def _numpy_is_quiet() -> Iterator[None]:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        yield


def refused_or_read(format: FormatName, path: Path, columns: Path | None = None) -> None:
    """Reads the file and looks at it as an import does."""
    try:
        found = formats.read(format, path, columns)
        consistent_parts(found, airborne(found))
    except ImportFormatError as error:
        assert str(error)  # noqa: PT017 (either outcome is good)


def _usd_log(version: int, names: list[str], letters: list[str], rows: list[bytes]) -> bytes:
    head = struct.pack("<BHHH", 0xBC, version, 1, 1) + b"x\0" + struct.pack("<H", len(names))
    variables = zip(names, letters, strict=True)
    head += b"".join(f"{name}({letter})".encode() + b"\0" for name, letter in variables)
    size = struct.calcsize("<" + ("I" if version == 1 else "Q") + "".join(letters))
    body = head + b"".join(struct.pack("<H", 1) + row[:size].ljust(size, b"\0") for row in rows)
    return body + struct.pack("<I", zlib.crc32(body))


@MORE
@given(
    version=st.sampled_from([1, 2]),
    letters=st.lists(
        st.sampled_from("bBhHiIqQefd"),
        min_size=len(USD_VARIABLES),
        max_size=len(USD_VARIABLES),
    ),
    rows=st.lists(st.binary(max_size=160), max_size=6),
)
def test_usd_log_of_any_values_is_refused_or_read(
    tmp_path: Path, version: int, letters: list[str], rows: list[bytes]
) -> None:
    path = tmp_path / "log"
    path.write_bytes(_usd_log(version, list(USD_VARIABLES), letters, rows))
    refused_or_read("crazyflie-usd", path)


@pytest.mark.parametrize(
    "rows",
    [
        [["0", *["1e308"] * 7, *["0"] * 11], ["1", *["-1e308"] * 7, *["0"] * 11]],
        [["0", *["0"] * 3, "0", "0", "0", "1", *["0"] * 11], ["9"] * 19],
    ],
)
def test_nanobench_of_extreme_cells_is_refused_or_read(tmp_path: Path, rows: list[list[str]]) -> None:
    path = tmp_path / "log"
    lines = [nanobench.COLUMNS, *rows]
    path.write_text("\n".join(",".join(line) for line in lines), encoding="utf-8", newline="")
    refused_or_read("nanobench", path)


@pytest.mark.parametrize(
    "rows",
    [
        [[0.0, *[1e308] * 10], [3.0, *[-1e308] * 10], [6.0, *[1e308] * 10]],
        [[float(k), 1e300, -1e300, 1e-300, k, 0.0, 0.0, 1e200, 0.0, 0.0, 1.0] for k in range(8)],
    ],
)
def test_csv_of_extreme_numbers_is_refused_or_read(tmp_path: Path, rows: list[list[float]]) -> None:
    path, columns = tmp_path / "log", tmp_path / "map.toml"
    columns.write_text(MAP)
    text = ["t,x,y,z,a,b,c,d,e,f,T", *(",".join(map(repr, row)) for row in rows)]
    path.write_text("\n".join(text), encoding="utf-8")
    refused_or_read("csv", path, columns)


@MORE
@given(text=st.text(max_size=200))
@example(text="world = []\nunknown = 3\nposition_m = [[], 1]")
@example(text="[world]\nx = 1\n[[unknown]]\n")
def test_any_column_map_is_refused_as_configuration(tmp_path: Path, text: str) -> None:
    path, columns = tmp_path / "log", tmp_path / "map.toml"
    columns.write_bytes(text.encode("utf-8", "surrogatepass"))
    path.write_text("t\n1\n2\n")
    with pytest.raises(ConfigurationError):
        formats.read("csv", path, columns)


@pytest.mark.parametrize(("format", "columns"), [("csv", None), ("nanobench", Path("m"))])
def test_map_that_does_not_fit_the_format_is_the_callers_mistake(
    format: FormatName, columns: Path | None
) -> None:
    with pytest.raises(ValueError) as caught:  # noqa: PT011
        formats.read(format, Path("log"), columns)
    assert not isinstance(caught.value, ImportFormatError)
