"""Rows of a study of attacks that nobody ran."""

from __future__ import annotations

from typing import Any


def made_up_rows(**changes: Any) -> dict[str, list[dict[str, Any]]]:
    """Return the rows of one case of each kind; `changes` to the flight beside a stranger."""
    flight = {
        "kind": "hold",
        "address": "stranger",
        "signed": False,
        "flown": True,
        "takeover": None,
        "departed_m": 0.0,
        "crashed": False,
        "error": None,
        "changed": False,
        "misreported": False,
    }
    return {
        "frames": [{"kind": "content", "trials": 10, "accepted": 0, "lockouts": 0}],
        "mutant": [{"mutant": "no replay window", "caught_by": {"replayed": {}}}],
        "flight": [flight | changes],
        "flood": [
            {
                "seed": 1,
                "quiet_rmse_m": 0.01,
                "flooded_rmse_m": 0.011,
                "quiet_whole": True,
                "flooded_whole": True,
                "quiet_failsafe": None,
                "flooded_failsafe": None,
            }
        ],
        "paths": [{"paths": 5, "opened": []}],
        "crowd": [
            {"crowd": "nine clients", "flown": True, "failsafe": None, "error": None, "tracking_rmse_m": 0.01}
        ],
    }
