"""CSV columns by name: every problem has its line, column and remedy."""

from __future__ import annotations

from pathlib import Path

import pytest

from trimtab.host.base.bounds import CSV_LINE
from trimtab.host.imports import ImportFormatError
from trimtab.host.imports.formats.table import table, table_contents


def read(tmp_path: Path, text: str | bytes, *needed: str) -> dict[str, list[float]]:
    path = tmp_path / "flight.csv"
    path.write_bytes(text.encode() if isinstance(text, str) else text)
    return {name: values.tolist() for name, values in table(path, needed or ("t", "x")).columns.items()}


@pytest.mark.parametrize(
    "text",
    [
        "t,x\n1,2\n3,4\n",
        "t,x\r\n1,2\r\n3,4\r\n",
        "\ufefft, x\n1, 2\n\n3,4\n\n",
        'more,"x",t\nword,2,1\n,4,3',
    ],
    ids=["plain", "crlf", "mark, blanks, empty lines", "quoted, other columns"],
)
def test_table_of_two_columns_reads(tmp_path: Path, text: str) -> None:
    assert read(tmp_path, text) == {"t": [1.0, 3.0], "x": [2.0, 4.0]}


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "no column t, x; is it another format?"),
        ("a,b\n1,2\n", "no column t, x"),
        ("t,x,x\n1,2,3\n4,5,6\n", "two columns are named x"),
        ("t,x\n1,2\n", "fewer than two rows"),
        ("t,x\n1,2\n3,four\n", "line 3: x is not a finite number"),
        ("t,x\n1,2\n\n3,\n", "line 4: x is not a finite number"),
        ("t,x\n1,2\n3\n", "line 3: x is not a finite number"),
        ("t,x\n1,2\nnan,4\n", "line 3: t is not a finite number"),
        ("t,x\n1,2\n3,-inf\n", "line 3: x is not a finite number"),
        ("a\0b,x\n1,2\n", "no column t;"),
        (b"t,x\n1,2\n3,\xff\n", "not UTF-8 text at byte"),
        ("t,x\n1," + "2" * 200_000, "not a CSV file"),
    ],
)
def test_table_with_a_problem_names_it_in_one_line(tmp_path: Path, text: str | bytes, said: str) -> None:
    with pytest.raises(ImportFormatError) as caught:
        read(tmp_path, text)
    assert said in str(caught.value)
    assert str(caught.value).startswith("flight.csv: ")
    assert "\n" not in str(caught.value)


def test_name_of_a_missing_column_is_told_without_control_characters(tmp_path: Path) -> None:
    with pytest.raises(ImportFormatError, match=r"no column y\\x00w;"):
        read(tmp_path, "t,x\n1,2\n3,4\n", "y\0w")


@pytest.mark.parametrize("times", ["3,2,1", "0,0,1e-320"])
def test_contents_of_times_that_decrease_or_stand_still_have_finite_rates(tmp_path: Path, times: str) -> None:
    path = tmp_path / "flight.csv"
    path.write_text("\n".join(["t,x\0", *(f"{time},1" for time in times.split(","))]))
    found = table_contents(path, "t")
    assert found.duration_s == pytest.approx(2.0 if times == "3,2,1" else 0.0)
    assert [(topic.name, topic.rate_hz) for topic in found.topics] == [
        (name, 1.0 if times == "3,2,1" else 0.0) for name in ("t", r"x\x00")
    ]


def test_few_rows_without_numbers_are_skipped_and_counted(tmp_path: Path) -> None:
    rows = [f"{k},{2 * k}" for k in range(60)]
    rows[7], rows[20], rows[33] = "7,nan", ",40", "33,word"
    path = tmp_path / "flight.csv"
    path.write_text("\n".join(["t,x", *rows]))
    held = table(path, ("t", "x"))
    assert held.skipped == 3
    assert held.columns["t"].tolist() == [k for k in range(60) if k not in (7, 20, 33)]
    rows[1] = "1,inf"
    path.write_text("\n".join(["t,x", *rows]))
    with pytest.raises(ImportFormatError, match="line 3: x is not a finite number, and 3 more rows"):
        table(path, ("t", "x"))


@pytest.mark.parametrize("name", ["absent.csv", "."])
def test_table_that_cannot_be_opened_is_refused(tmp_path: Path, name: str) -> None:
    with pytest.raises(ImportFormatError, match="cannot be read"):
        table(tmp_path / name, ("t",))


@pytest.mark.parametrize(
    ("text", "told"),
    [
        pytest.param("t,x\n1," + "2" * CSV_LINE.limit + "\n", "line 2: length of a row", id="long line"),
        pytest.param("t,x\n" + '"1\n",' * (CSV_LINE.limit // 4), "length of a row", id="lines in quotes"),
        pytest.param(",".join("c" * 10_001) + "\n1\n", "line 1: columns: 10001", id="columns"),
    ],
)
def test_row_beyond_a_bound_is_refused_with_its_line(tmp_path: Path, text: str, told: str) -> None:
    path = tmp_path / "flight.csv"
    path.write_text(text)
    for act in (lambda: table(path, ("t", "x")), lambda: table_contents(path)):
        with pytest.raises(ImportFormatError, match=rf"flight\.csv: .*{told}"):
            act()
