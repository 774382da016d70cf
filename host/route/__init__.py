"""Routes: waypoints, gates, times, heading, limits and keep-out shapes, read strictly from TOML."""

from trimtab.host.route.checks import TIME_MAX_S, check_route
from trimtab.host.route.files import list_routes, load_route, parse_route, route_description, route_file
from trimtab.host.route.gates import Gate
from trimtab.host.route.generators import FigureEight, RandomWaypoints, random_route
from trimtab.host.route.model import LimitsOverride, Route, YawProfile
from trimtab.host.route.shapes import Box, Cylinder, Sphere

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
