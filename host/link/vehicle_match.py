"""Check that the vehicle at the port is the one that blobs were made for."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path

from trimtab.host.base.errors import UsageError
from trimtab.host.link.tasks import Identity
from trimtab.host.vehicle import ConfigurationError, list_vehicles, load_vehicle
from trimtab.protocol.blobs import NEUTRAL_BLOCK, FeedForward


def name_of(vehicle_id: str) -> str | None:
    """Return the name of the vehicle file with this id, shipped or in the current folder, or None."""
    here = Path.cwd()
    for name in list_vehicles(here):
        with suppress(ConfigurationError):
            if load_vehicle(name, here).id == vehicle_id:
                return name
    return None


def check_same_vehicle(identity: Identity, vehicle_id: str, *, what: str, port: str) -> None:
    """Raise UsageError if the vehicle at the port is not the one that `what` was made for."""
    if identity.vehicle_id != vehicle_id:
        port_name = name_of(identity.vehicle_id)
        raise UsageError(
            f"{port} is {_called(identity.vehicle_id)}, {what} is for {_called(vehicle_id)}; "
            f"make it again with --vehicle {port_name or 'and the file of that vehicle'}, or check the port"
        )


def neutral_feedforward(vehicle_id: str) -> FeedForward:
    """Return the feed-forward without effect: a vehicle flies with it as without any.

    It has version 1, which every vehicle accepts.
    """
    return FeedForward(vehicle_id=vehicle_id, model_id="0" * 12, block=NEUTRAL_BLOCK, version=1)


def _called(vehicle_id: str) -> str:
    name = name_of(vehicle_id)
    return f"vehicle {vehicle_id}" if name is None else f"the {name} ({vehicle_id})"
