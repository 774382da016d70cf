"""Numbers of nature the law uses."""

from __future__ import annotations

GRAVITY = 9.81
"""m/s^2, along +z_ned."""
