"""Physical constants of the control law."""

from __future__ import annotations

GRAVITY = 9.81
"""m/s^2, along +z_ned."""
