"""Vehicle files: what a quadrotor is, read strictly from TOML into one frozen type."""

from host.vehicle.files import list_vehicles, load_vehicle, parse_vehicle
from host.vehicle.model import Battery, Gains, Limits, Rotor, Vehicle
from host.vehicle.parameters import to_parameters
from host.vehicle.strict_toml import ConfigurationError

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
