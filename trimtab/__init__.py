"""Trimtab's public interface: plan, fly, import, read, trace and learn from Python.

    import trimtab as tt

    flights = [tt.read_flight("one.mcap"), tt.read_flight("two.mcap")]
    result = tt.trace(flights)
    print(result.verdict)

The verbs of the command line call the same functions. Names of vehicles, routes and effects are looked up in
the workspace first, which is the current folder by default. World is NED, body is FRD, units are SI; another
unit is part of a name, as in `t_us`. Each name is imported when it is first used.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from trimtab.host.api.fly import fly
    from trimtab.host.api.imports import Imported, import_log
    from trimtab.host.api.learn import learn
    from trimtab.host.api.load import load_effects, load_route, load_vehicle
    from trimtab.host.api.plan import plan
    from trimtab.host.api.predict import predict
    from trimtab.host.api.trace import trace, write_trace
    from trimtab.host.base.errors import LinkError, Refused, TrimtabError, UsageError
    from trimtab.host.compare.prediction import Prediction
    from trimtab.host.effects import EffectError
    from trimtab.host.export.samples import Samples, sample
    from trimtab.host.imports import ImportFormatError
    from trimtab.host.learn.result import Learned
    from trimtab.host.link.blob_files import read_reference
    from trimtab.host.link.fly import FlightEnded
    from trimtab.host.link.summary import FlightResult
    from trimtab.host.log import Flight, LogError, read_flight
    from trimtab.host.log.errors import TooLittleData
    from trimtab.host.models.file import read_model, write_model
    from trimtab.host.models.model import Model
    from trimtab.host.plan import Plan, PlanRefused, PlanUnsolved, write_plan
    from trimtab.host.trace.decision.findings import LogsRefused
    from trimtab.host.trace.result import Trace
    from trimtab.host.vehicle import ConfigurationError
    from trimtab.host.workspace import open_workspace

_HOMES = {
    "ConfigurationError": "vehicle",
    "EffectError": "effects",
    "Flight": "log",
    "FlightEnded": "link.fly",
    "FlightResult": "link.summary",
    "ImportFormatError": "imports",
    "Imported": "api.imports",
    "Learned": "learn.result",
    "LinkError": "base.errors",
    "LogError": "log",
    "LogsRefused": "trace.decision.findings",
    "Model": "models.model",
    "Plan": "plan",
    "PlanRefused": "plan",
    "PlanUnsolved": "plan",
    "Prediction": "compare.prediction",
    "Refused": "base.errors",
    "Samples": "export.samples",
    "TooLittleData": "log.errors",
    "Trace": "trace.result",
    "TrimtabError": "base.errors",
    "UsageError": "base.errors",
    "fly": "api.fly",
    "import_log": "api.imports",
    "learn": "api.learn",
    "load_effects": "api.load",
    "load_route": "api.load",
    "load_vehicle": "api.load",
    "open_workspace": "workspace",
    "plan": "api.plan",
    "predict": "api.predict",
    "read_flight": "log",
    "read_model": "models.file",
    "read_reference": "link.blob_files",
    "sample": "export.samples",
    "trace": "api.trace",
    "write_model": "models.file",
    "write_plan": "plan",
    "write_trace": "api.trace",
}
"""Module below `trimtab.host` that defines each public name."""

__all__ = [
    "ConfigurationError",
    "EffectError",
    "Flight",
    "FlightEnded",
    "FlightResult",
    "ImportFormatError",
    "Imported",
    "Learned",
    "LinkError",
    "LogError",
    "LogsRefused",
    "Model",
    "Plan",
    "PlanRefused",
    "PlanUnsolved",
    "Prediction",
    "Refused",
    "Samples",
    "TooLittleData",
    "Trace",
    "TrimtabError",
    "UsageError",
    "fly",
    "import_log",
    "learn",
    "load_effects",
    "load_route",
    "load_vehicle",
    "open_workspace",
    "plan",
    "predict",
    "read_flight",
    "read_model",
    "read_reference",
    "sample",
    "trace",
    "write_model",
    "write_plan",
    "write_trace",
]


def __getattr__(name: str) -> Any:
    """Import a public name on first use. Raises AttributeError for any other name."""
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = getattr(import_module(f"trimtab.host.{_HOMES[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    """Return the public names."""
    return sorted(__all__)
