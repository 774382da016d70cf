"""What a log says of who flew, and when."""

from __future__ import annotations

import pytest

from trimtab.host.log.provenance import date_text, flown_by, origin_of, utc_date

UTC_US = 1_795_000_000_123_456  # 2026-11-18


@pytest.mark.parametrize(
    ("simulated", "utc_us", "entries"),
    [
        (True, UTC_US, {"simulated": "yes"}),  # a simulated flight at a port holds no wall clock
        (True, None, {"simulated": "yes"}),
        (False, UTC_US, {"simulated": "no", "epoch_us": str(UTC_US)}),
        (None, UTC_US, {"epoch_us": str(UTC_US)}),
        (None, None, {}),
    ],
)
def test_real_flights_have_a_date_and_simulated_ones_none(
    simulated: bool | None, utc_us: int | None, entries: dict[str, str]
) -> None:
    assert flown_by(simulated, utc_us) == entries


def test_date_of_a_real_flight_is_read_again() -> None:
    metadata = {"kind": "flight", "command": "trimtab fly a.ref --port x", **flown_by(False, UTC_US)}
    assert origin_of(metadata) == "port"
    assert date_text(utc_date(metadata)) == "2026-11-18T11:06:40Z"
