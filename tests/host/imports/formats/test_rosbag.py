"""Bags that rosbags wrote: ROS 1, ROS 2 with SQLite and MCAP."""

from __future__ import annotations

import pytest

pytest.importorskip("rosbags", reason="rosbags is not installed; pip install 'trimtab[logs]'")
