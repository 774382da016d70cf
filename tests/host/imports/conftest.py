"""A made-up flight and the foreign files that would hold it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from tests.foreign import flight
from tests.foreign.flight import BODIES, WORLDS, G, MadeUp, in_axes
from tests.foreign.tables import nanobench_columns, write_csv
from tests.foreign.usd import USD_VARIABLES, usd_bytes, usd_flight, usd_rows, with_sum


@pytest.fixture(scope="session")
def made_up() -> MadeUp:
    return flight.made_up()


@pytest.fixture(scope="session")
def foreign() -> SimpleNamespace:
    """The writers, for tests to write files with."""
    return SimpleNamespace(
        G=G,
        WORLDS=WORLDS,
        BODIES=BODIES,
        USD_VARIABLES=USD_VARIABLES,
        in_axes=in_axes,
        write_csv=write_csv,
        nanobench_columns=nanobench_columns,
        usd_rows=usd_rows,
        usd_bytes=usd_bytes,
        usd_flight=usd_flight,
        with_sum=with_sum,
    )


@pytest.fixture
def nanobench_file(tmp_path: Path, made_up: MadeUp) -> Callable[..., Path]:
    """Writes a NanoBench file; keywords replace columns, None removes one."""

    def write(**changes: Sequence[object] | np.ndarray | None) -> Path:
        columns: dict[str, Sequence[object] | np.ndarray] = dict(nanobench_columns(made_up))
        for name, values in changes.items():
            if values is None:
                del columns[name]
            else:
                columns[name] = values
        return write_csv(tmp_path / "flight.csv", columns)

    return write
