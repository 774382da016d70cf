"""Routes: waypoints, gates, times, heading, limits and keep-out shapes, read strictly from TOML."""

from host.route.checks import TIME_MAX_S, check_route
from host.route.files import list_routes, load_route, parse_route, route_description, route_file
from host.route.gates import Gate
from host.route.generators import FigureEight, RandomWaypoints, random_route
from host.route.model import LimitsOverride, Route, YawProfile
from host.route.shapes import Box, Cylinder, Sphere

__all__ = [
    "TIME_MAX_S",
    "Box",
    "Cylinder",
    "FigureEight",
    "Gate",
    "LimitsOverride",
    "RandomWaypoints",
    "Route",
    "Sphere",
    "YawProfile",
    "check_route",
    "list_routes",
    "load_route",
    "parse_route",
    "random_route",
    "route_description",
    "route_file",
]
