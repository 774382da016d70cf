"""Effects, vehicles and routes by name, as the verbs find them: in the workspace, then among the shipped."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from trimtab.host.workspace import Workspace, open_workspace

if TYPE_CHECKING:
    from trimtab.host.effects import Effect
    from trimtab.host.route import Route
    from trimtab.host.vehicle import Vehicle


def load_effects(workspace: str | Path | Workspace | None = None) -> dict[str, Effect]:
    """Return the candidate effects by name: the shipped ones, then those of the workspace.

    Parameters
    ----------
    workspace
        Folder that may hold a folder `effects`. Default: the current folder.

    Returns
    -------
    dict[str, Effect]
        Each effect has its equation, and its parameters with units, typical sizes and tolerances.

    Raises
    ------
    UsageError
        If the folder does not exist.
    EffectError
        If an effect file of the workspace cannot be used.
    """
    return open_workspace(workspace).effects()


def load_vehicle(vehicle: str | Path, workspace: str | Path | Workspace | None = None) -> Vehicle:
    """Return a vehicle: mass, inertia, rotors, limits, gains and tolerances in SI units, frame FRD.

    Parameters
    ----------
    vehicle
        Name, or path of a .toml file. Names are looked up in the workspace first.
    workspace
        Folder that may hold a folder `vehicles`. Default: the current folder.

    Returns
    -------
    Vehicle
        Its fields are the keys of vehicle files.

    Raises
    ------
    UsageError
        If the folder does not exist.
    ConfigurationError
        If there is no such vehicle, or its file has problems.
    """
    return open_workspace(workspace).vehicle(vehicle)


def load_route(
    route: str | Path, workspace: str | Path | Workspace | None = None, vehicle: Vehicle | None = None
) -> Route:
    """Return a route: waypoints in NED in metres, times in seconds, heading, limits and obstacles.

    Parameters
    ----------
    route
        Name, path of a .toml file, or `NAME:SEED` to draw a random route with another seed.
    workspace
        Folder that may hold a folder `routes`. Default: the current folder.
    vehicle
        Vehicle that is to fly the route. It makes the errors more complete.

    Returns
    -------
    Route
        Its fields are the keys of route files.

    Raises
    ------
    UsageError
        If the folder does not exist.
    ConfigurationError
        If there is no such route, or its file has problems.
    """
    return open_workspace(workspace).route(route, vehicle)


def vehicle_of(vehicle: Vehicle | str | Path, space: Workspace) -> Vehicle:
    """Return a vehicle, or the one of a name or path. Raises ConfigurationError."""
    return space.vehicle(vehicle) if isinstance(vehicle, str | Path) else vehicle
