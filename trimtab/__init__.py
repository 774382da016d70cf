"""Trimtab's public interface: read flights, plan, learn and trace from Python.

    from trimtab import load_effects, read_flight, trace

    flights = [read_flight("one.mcap"), read_flight("two.mcap")]
    result = trace(flights, held_out=[], effects=load_effects())

Each name is imported when it is first used.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from trimtab.host.effects import load_effects
    from trimtab.host.export.samples import sample
    from trimtab.host.learn.learn import learn
    from trimtab.host.link.blob_files import read_reference
    from trimtab.host.log import read_flight
    from trimtab.host.models.file import read_model, write_model
    from trimtab.host.plan import plan, write_plan
    from trimtab.host.route import load_route
    from trimtab.host.trace.run import run as trace
    from trimtab.host.vehicle import load_vehicle

__all__ = [
    "learn",
    "load_effects",
    "load_route",
    "load_vehicle",
    "plan",
    "read_flight",
    "read_model",
    "read_reference",
    "sample",
    "trace",
    "write_model",
    "write_plan",
]

_HOMES = {
    "learn": ("trimtab.host.learn.learn", "learn"),
    "load_effects": ("trimtab.host.effects", "load_effects"),
    "load_route": ("trimtab.host.route", "load_route"),
    "load_vehicle": ("trimtab.host.vehicle", "load_vehicle"),
    "plan": ("trimtab.host.plan", "plan"),
    "read_flight": ("trimtab.host.log", "read_flight"),
    "read_model": ("trimtab.host.models.file", "read_model"),
    "read_reference": ("trimtab.host.link.blob_files", "read_reference"),
    "sample": ("trimtab.host.export.samples", "sample"),
    "trace": ("trimtab.host.trace.run", "run"),
    "write_model": ("trimtab.host.models.file", "write_model"),
    "write_plan": ("trimtab.host.plan", "write_plan"),
}


def __getattr__(name: str) -> Any:
    """Import a public name on first use. Raises AttributeError for any other name."""
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    module, attribute = _HOMES[name]
    value = getattr(import_module(module), attribute)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    """Return the public names."""
    return sorted(__all__)
