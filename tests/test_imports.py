"""Who may import whom: the design's table as an allow-list, and third-party packages at the edges."""

from __future__ import annotations

import ast
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
NAME = "trimtab"
OURS = ("firmware_model", "host", "protocol", "sitl")
"""Packages of ours; imported as trimtab.host and so on, named here and in the tables without the prefix."""
LEAVES = ("host.base", "host.codegen", "host.vehicle", "host.log")
OPENED = ("host.effects", "host.trace", "host.models.model")
"""What scoring may use beside the leaves: the library, tracing, and the type tracing predicts with."""

ALLOWED: dict[str, tuple[str, ...]] = {
    "protocol": ("protocol",),
    "firmware_model.law": ("firmware_model.law",),
    "firmware_model": ("firmware_model", "protocol"),
    # The leaves that sitl may use import nothing else of host; the ground floor imports nothing of ours.
    "host.base": ("host.base",),
    "host.codegen": (*LEAVES, "protocol", "firmware_model.law"),
    "host.vehicle": (*LEAVES, "protocol", "firmware_model.law"),
    "host.log": (*LEAVES, "protocol", "firmware_model.law"),
    # Below planning, learning, links and applications.
    "host.control": (
        "host.control",
        *LEAVES,
        "host.effects",
        "host.models",
        "host.shooting",
        "protocol",
        "firmware_model.law",
    ),
    "host": ("host", "protocol", "firmware_model.law"),
    "sitl.studies.scoring": ("sitl", "protocol", "firmware_model", *LEAVES, *OPENED),
    # What takes bytes from outside is on both sides of the link.
    "sitl.studies.fuzz": ("sitl", "protocol", "firmware_model", "host"),
    # It attacks flights of the host.
    "sitl.studies.attack": ("sitl", "protocol", "firmware_model", "host"),
    # It learns and flies the paper's controllers with the host's code, which receives the truth as arrays.
    "sitl.studies.labels": ("sitl", "protocol", "firmware_model", "host"),
    # The pace of an upload in flight is the host's.
    "sitl.studies.upload_flight": ("sitl", "protocol", "firmware_model", "host"),
    "sitl": ("sitl", "protocol", "firmware_model", *LEAVES),
}
"""Package to what of ours it may import; the longest matching name decides."""

EDGES: dict[str, tuple[str, ...]] = {
    "apsw": ("host.imports.formats.bag_bounds",),
    "casadi": (
        "host.apps.bench.naive",
        "host.apps.bench.naive_mpc",
        "host.apps.bench.rockit_ocp",
        "host.codegen",
        "host.control",
        "host.learn",
        "host.models",
        "host.plan",
        "host.shooting",
        "host.trace",
        "sitl.studies.plants",
    ),
    "crazyflow": ("sitl.studies.plants",),
    "cyclopts": ("host.cli", "host.verbs"),
    "diffrax": ("host.apps.bench.jax_rollouts",),
    "fastcrc": ("protocol",),
    "foxglove_schemas_protobuf": ("host.log",),
    "google": ("protocol", "host.log"),
    "grpc_tools": ("protocol.generate",),
    "jax": ("host.apps.bench.jax_loop", "host.apps.bench.jax_rollouts"),
    "jinja2": ("host.report",),
    "markupsafe": ("host.report",),  # comes with jinja2
    "matplotlib": ("host.report", "host.verbs"),
    "lz4": ("host.imports.formats.bag_bounds",),
    "mcap": ("host.log",),
    "mcap_protobuf": ("host.log",),
    "minsnap_trajectories": ("host.apps.bench.snap_peer",),
    "numpy": ("host", "sitl"),
    "pydantic": ("host", "sitl"),
    "pydantic_core": ("host.vehicle",),
    "pysindy": ("sitl.studies.scoring.baselines",),
    "pymavlink": (
        "host.imports.formats.dataflash",
        "protocol.codec",
        "protocol.generate",
        "protocol.generated",
    ),
    "rich": ("host.base.live", "host.base.progress"),
    "rockit": ("host.apps.bench.rockit_ocp",),
    "rotorpy": ("sitl.studies.plants",),
    "scipy": ("host", "sitl"),
    "serial": ("host.link.ports",),
    "threadpoolctl": ("host.base.parallel",),
    "zstandard": ("host.log",),
}
"""Third-party package to the places that may import it; one that is not listed may be imported nowhere."""


def module_name(path: Path) -> str:
    """Dotted name of a source file below the root."""
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def within(name: str, packages: tuple[str, ...]) -> bool:
    """Whether `name` is one of `packages` or lies in one."""
    return any(name == package or name.startswith(package + ".") for package in packages)


def is_module(name: str) -> bool:
    """Whether one of our own modules or packages has this full name."""
    path = ROOT.joinpath(*name.split("."))
    return path.is_dir() or path.with_suffix(".py").is_file()


def imports(source: str) -> Iterator[tuple[int, str]]:
    """(line, module) of every import in a source text, in functions too; relative ones start with a dot."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            for alias in node.names:
                yield node.lineno, alias.name
        elif isinstance(node, ast.ImportFrom):
            base = "." * node.level + (node.module or "")
            for alias in node.names:
                inner = f"{base}.{alias.name}"
                yield node.lineno, inner if base.split(".")[0] == NAME and is_module(inner) else base
        elif isinstance(node, ast.Call) and node.args and isinstance(node.args[0], ast.Constant):
            called = node.func.attr if isinstance(node.func, ast.Attribute) else getattr(node.func, "id", "")
            if called in ("import_module", "__import__") and isinstance(node.args[0].value, str):
                yield node.lineno, node.args[0].value


def violations(module: str, source: str) -> list[str]:
    """One line for each import of `module` that the tables do not allow."""
    rule = max((name for name in ALLOWED if within(module, (name,))), key=len)
    found = []
    for line, target in imports(source):
        top = target.split(".")[0]
        if target.startswith("."):
            found.append(f"{module}:{line} imports relatively")
        elif top in OURS:
            found.append(f"{module}:{line} imports {target}; write {NAME}.{target}")
        elif top == NAME:
            allowed = ALLOWED[rule]
            if not within(target.removeprefix(f"{NAME}."), allowed):
                found.append(f"{module}:{line} imports {target}; {rule} may import {', '.join(allowed)}")
        elif top not in sys.stdlib_module_names and not within(module, EDGES.get(top, ())):
            found.append(f"{module}:{line} imports {target}; only {EDGES.get(top, 'nobody')} may")
    return found


SOURCES = sorted(path for package in OURS for path in (ROOT / package).rglob("*.py"))


@pytest.mark.parametrize("package", OURS)
def test_imports_of_package_stay_within_allow_list(package: str) -> None:
    chosen = [path for path in SOURCES if path.relative_to(ROOT).parts[0] == package]
    assert chosen
    found = [line for path in chosen for line in violations(module_name(path), path.read_text("utf-8"))]
    assert found == []


@pytest.mark.parametrize("package", ["host", "firmware_model"])
def test_package_root_of_allowed_subpackage_imports_nothing(package: str) -> None:
    # Whoever imports host.vehicle or firmware_model.law also runs the package's own __init__.
    assert list(imports((ROOT / package / "__init__.py").read_text("utf-8"))) == []


@pytest.mark.parametrize(
    ("module", "source"),
    [
        ("host.link.client", "from trimtab.sitl import vehicle"),
        ("host.plan.solve", "def f():\n    import trimtab.firmware_model.flight.supervisor"),
        ("host.plan.solve", "from trimtab.firmware_model import supervisor"),
        ("host.control.mpc", "from trimtab.host.link import session"),
        ("host.vehicle.files", "from trimtab.host.route import load_route"),
        ("host.base.artefacts", "from trimtab.host.vehicle import load_vehicle"),
        ("host.log.reader", "if TYPE_CHECKING:\n    import trimtab.host.trace"),
        ("protocol.upload", "import trimtab.host"),
        ("firmware_model.law.dfbc", "import numpy"),
        ("firmware_model.law.dfbc", "from trimtab.protocol import parameters"),
        ("firmware_model.flight.engine", "import casadi"),
        ("sitl.plant", "from trimtab.host.trace import evidence"),
        ("sitl.plant", "from rotorpy.vehicles import multirotor"),
        ("sitl.studies.blind", "import crazyflow"),
        ("sitl.studies.blind", "from trimtab.host.trace import evidence"),
        ("sitl.studies.flights", "from trimtab.host.effects import load_effects"),
        ("sitl.studies.scoring.world", "from trimtab.host.models import phi"),
        ("sitl.plant", "import importlib\nimportlib.import_module('trimtab.host.effects')"),
        ("host.link.client", "import serial"),
        ("host.report.page", "import pandas"),
        ("host.cli", "from . import output"),
        ("host.cli", "from host import output"),
        ("host.cli", "import trimtab"),
    ],
)
def test_forbidden_import_is_found(module: str, source: str) -> None:
    assert len(violations(module, source)) == 1


@pytest.mark.parametrize(
    ("module", "source"),
    [
        (
            "host.plan.solve",
            "from trimtab.firmware_model import law\nfrom trimtab.firmware_model.law.ops import FLOAT",
        ),
        (
            "sitl.vehicle",
            "from trimtab.host.vehicle import Vehicle\nfrom trimtab.host.codegen import compile_blocks",
        ),
        ("sitl.studies.scoring", "from trimtab.host.trace import evidence"),
        ("sitl.studies.scoring.bounds", "from trimtab.host.effects import load_effects"),
        ("host.link.ports", "import serial, math"),
    ],
)
def test_allowed_import_passes(module: str, source: str) -> None:
    assert violations(module, source) == []
