"""Vehicle files: the properties of a quadrotor, read strictly from TOML into a frozen type."""

from trimtab.host.vehicle.files import list_vehicles, load_vehicle, parse_vehicle
from trimtab.host.vehicle.model import Battery, Gains, Limits, Rotor, Vehicle
from trimtab.host.vehicle.parameters import to_parameters
from trimtab.host.vehicle.strict_toml import ConfigurationError

__all__ = [
    "Battery",
    "ConfigurationError",
    "Gains",
    "Limits",
    "Rotor",
    "Vehicle",
    "list_vehicles",
    "load_vehicle",
    "parse_vehicle",
    "to_parameters",
]
