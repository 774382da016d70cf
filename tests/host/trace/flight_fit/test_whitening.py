"""Orders of the autoregression that bins determine."""

from __future__ import annotations

import numpy as np
import pytest

from trimtab.host.trace.decision.rules import RULES
from trimtab.host.trace.flight_fit.whitening import WINDOWS, affordable

EACH = RULES.bins_per_order


@pytest.mark.parametrize(
    ("bins", "expected"),
    [
        pytest.param(1, 1, id="too-few-for-any"),
        pytest.param(EACH, 1, id="one-less-than-the-first-needs"),
        pytest.param(2 * EACH + 1, 1, id="one-less-than-the-second-needs"),
        pytest.param(2 * EACH + 2, 2, id="as-many-as-the-second-needs"),
        pytest.param(99 * EACH, len(WINDOWS), id="many"),
    ],
)
def test_an_order_needs_bins_with_known_bins_before_them(bins: int, expected: int) -> None:
    assert affordable([np.ones(bins, dtype=bool)]) == expected


def test_bins_between_gaps_determine_no_order_that_looks_back_beyond_them() -> None:
    """Of poses every 50 ms, one of five bins of 40 ms holds none, so no six bins in a row are known."""
    known = np.arange(40 * EACH) % 5 > 0
    assert affordable([known, known]) == 3
