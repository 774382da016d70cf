"""Constants have one home each."""

from __future__ import annotations

import ast
from collections.abc import Callable
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
OURS = ("firmware_model", "host", "protocol", "sitl")


def _is_gravity(node: ast.AST) -> bool:
    return isinstance(node, ast.Constant) and node.value == 9.81


def _is_tick(node: ast.AST) -> bool:
    return isinstance(node, ast.Assign) and any(
        isinstance(target, ast.Name) and target.id == "TICK_US" for target in node.targets
    )


@pytest.mark.parametrize(
    ("found", "homes"),
    [
        # The plant is written apart from host and firmware, and has its own.
        (_is_gravity, {"firmware_model/law/constants.py", "sitl/surroundings.py"}),
        (_is_tick, {"protocol/telemetry.py"}),
    ],
)
def test_constant_stands_at_home_only(found: Callable[[ast.AST], bool], homes: set[str]) -> None:
    paths = [path for package in OURS for path in (ROOT / package).rglob("*.py")]
    places = {
        path.relative_to(ROOT).as_posix()
        for path in paths
        if any(map(found, ast.walk(ast.parse(path.read_text("utf-8")))))
    }
    assert places == homes
