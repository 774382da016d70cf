"""Constants of the simulated physics of a flight, from vehicle file and world."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from trimtab.host.vehicle import Vehicle
from trimtab.sitl.draw import World
from trimtab.sitl.plant_model import TICK_S
from trimtab.sitl.surroundings import GRAVITY_M_S2

SINK_M = 5e-4  # depth of the feet in the floor under the vehicle's weight
_FLOOR_DAMPING = 0.7
_CELL_RESISTANCE_OHM_AH = 0.012  # of one cell, times its capacity
_HOVER_POWER_W_PER_N = 15.0
_BATTERY_SHARE = 0.3  # share of the mass that slides if the centre of mass is displaced
_LAG_UNEVEN = 0.05  # a motor slower than in its file slows down even more slowly than it speeds up
_AIR_DENSITY_KG_M3 = 1.2
_DISC_SHARE = 0.7  # rotor radius over half the distance to the next hub
_INERTIA_PRODUCTS = (0.03, 0.05, -0.04)  # xy, xz, yz over the change of the moments of inertia
SHOWN_BY = {"com-offset": "com_frd"}
"""Names in `plant_parameters` of what one effect brings with another, in the unit of its parameters."""
_BOLTED_FRD = (0.03, -0.02, 0.24)  # position of an additional mass over the arm length
_TRAY_END = 0.24  # greatest slide of a battery in either direction over the arm length
_MOMENTUM_SPREAD = (0.0015, -0.001, 0.001, -0.0015)  # relative spread of the rotors' angular momenta


def plant_parameters(vehicle: Vehicle, world: World) -> dict[str, list[float]]:
    """Return the plant's constants, by the names in `plant_model.PARAMETERS`."""
    value = world.value
    mass = vehicle.mass_kg * value("mass", "factor")
    com, inertia = _mass_properties(vehicle, world)
    weight = vehicle.mass_kg * GRAVITY_M_S2
    inflow = _hover_inflow(vehicle)
    lag = vehicle.motor_lag_s + value("motor-lag", "extra_s")
    ratio = value("uneven-lag", "ratio")
    uneven = (ratio - 1.0) / (ratio + 1.0) + (_LAG_UNEVEN if "motor-lag" in world.effects else 0.0)
    spins = [1.0 if rotor.spin == "ccw" else -1.0 for rotor in vehicle.rotors]
    stiffness = weight / (4.0 * SINK_M)
    battery, turbulence = vehicle.battery, world.turbulence
    keep = math.exp(-TICK_S / turbulence.correlation_s)
    fresh = math.sqrt(1.0 - keep * keep)
    hover = weight / (4.0 * vehicle.thrust_max_n)
    wheel = value("gyroscopic", "h") * vehicle.inertia_kg_m2[0]
    slope = value("shifting-battery", "slope")
    return {
        "mass_kg": [mass],
        "inertia": _six(inertia),
        "inertia_inverse": _six(np.linalg.inv(inertia)),
        "com_frd": com.tolist(),
        "rotors_frd": [c for rotor in vehicle.rotors for c in rotor.position_m],
        "spins": spins,
        "thrust_max_n": [vehicle.thrust_max_n],
        "thrust_curve": list(vehicle.thrust_curve),
        "torque_per_thrust_m": [vehicle.torque_per_thrust_m],
        "hover_speed": [math.sqrt(hover)],
        "rise_half_tick": [math.exp(-0.5 * TICK_S / (lag * (1.0 - uneven)))],
        "fall_half_tick": [math.exp(-0.5 * TICK_S / (lag * (1.0 + uneven)))],
        "thrust_gain": [value("thrust-gain", "gain")],
        "linear_drag": [value("linear-drag", key) for key in ("dx", "dy", "dz")],
        "quadratic_drag": [value("quadratic-drag", "c")],
        "wind_ned": [value("wind", key) for key in ("wx", "wy")],
        "flapping": [value("blade-flapping", "moment")],
        "tether": [
            value("elastic-tether", key)
            for key in ("stiffness", "damping", "slack_m", "anchor_x_m", "anchor_y_m", "anchor_z_m")
        ],
        "floor": [stiffness, 2.0 * _FLOOR_DAMPING * math.sqrt(stiffness * vehicle.mass_kg / 4.0)],
        "sag_exponent": [value("battery-sag", "exponent")],
        "battery": [
            battery.full_v,
            battery.empty_v,
            battery.cells * _CELL_RESISTANCE_OHM_AH / battery.capacity_ah,
            battery.capacity_ah * 3600.0,
            _HOVER_POWER_W_PER_N * weight,
        ],
        "gust": [keep, fresh * turbulence.force_m_s2, fresh * turbulence.torque_rad_s2],
        "hover_inflow": [inflow, inflow**4],
        "translational_lift": [value("translational-lift", "k") * vehicle.mass_kg * inflow],
        "thrust_inflow": [0.25 * value("thrust-inflow", "k") * vehicle.mass_kg],
        "rotor_loss": [value("rotor-loss", f"loss_{i}") for i in (1, 2, 3, 4)],
        "ground_effect": [value("ground-effect", "k")],
        "gyroscopic": [wheel * s * (1.0 + e) for s, e in zip(spins, _MOMENTUM_SPREAD, strict=True)],
        "torque_bias": [
            j * value("torque-bias", axis) for j, axis in zip(vehicle.inertia_kg_m2, "xyz", strict=True)
        ],
        "hover_thrust_n": [weight],
        "cant": [c for i in (1, 2, 3, 4) for c in _canted(value, i)],
        "dead_zone": _dead_zone(
            vehicle, hover * value("dead-zone", "centre"), hover * value("dead-zone", "width")
        ),
        "fan": [
            *(value("fan", key) for key in ("push_m_s2", "width_m", "x_m", "y_m")),
            *_north_east(value("fan", "towards")),
        ],
        "wall": [
            *(value("wall-suction", key) for key in ("pull_m_s2", "distance_m")),
            *_north_east(value("wall-suction", "towards")),
        ],
        "payload": [
            value("slung-payload", "ratio") * vehicle.mass_kg,
            value("slung-payload", "length_m"),
            2.0
            * value("slung-payload", "damping")
            * math.sqrt(GRAVITY_M_S2 / value("slung-payload", "length_m")),
        ],
        "slide": [
            *(value("shifting-battery", key) for key in ("share", "stiffness")),
            math.cos(slope),
            math.sin(slope),
            _TRAY_END * _reach(vehicle),
        ],
        "sweep": [
            value("sweeping-fan", "push_m_s2"),
            1.0 / value("sweeping-fan", "period_s"),
            *_north_east(value("sweeping-fan", "towards")),
        ],
        "dropped_load": [
            value("dropped-load", "share") * vehicle.mass_kg,
            value("dropped-load", "at_s"),
        ],
        "held_camera": [value("stabilised-camera", "lever_m")],
        "stutter": [
            *_of_one_rotor(vehicle, value("stuttering-motor", "towards"), value("stuttering-motor", "depth")),
            1.0 / value("stuttering-motor", "every_s"),
            value("stuttering-motor", "length_s") / value("stuttering-motor", "every_s"),
        ],
    }


def _mass_properties(vehicle: Vehicle, world: World) -> tuple[np.ndarray, np.ndarray]:
    """Return the centre of mass in FRD and the inertia about it.

    A displaced centre of mass means that the battery has slid. A deviation of the mass is a body attached
    below. Deviating moments of inertia come with products of inertia.
    """
    factor = world.value("mass", "factor")
    mass = vehicle.mass_kg * factor
    nominal = np.array(vehicle.inertia_kg_m2)
    wrong = np.array([world.value("inertia", axis) for axis in "xyz"]) - 1.0
    inertia = np.diag(nominal * (1.0 + wrong))
    for (i, k), share in zip(((0, 1), (0, 2), (1, 2)), _INERTIA_PRODUCTS, strict=True):
        inertia[i, k] = inertia[k, i] = share * np.linalg.norm(wrong) * math.sqrt(nominal[i] * nominal[k])
    slid = np.array([world.value("com-offset", "x"), world.value("com-offset", "y"), 0.0])
    inertia += mass * (1.0 / _BATTERY_SHARE - 1.0) * _spread(slid)
    bolted = _reach(vehicle) * np.array(_BOLTED_FRD)
    inertia += vehicle.mass_kg * (1.0 - 1.0 / factor) * _spread(bolted)
    return slid + (1.0 - 1.0 / factor) * bolted, inertia


def _reach(vehicle: Vehicle) -> float:
    """Return the length of an arm, m."""
    return math.hypot(*vehicle.rotors[0].position_m[:2])


def _spread(r: np.ndarray) -> np.ndarray:
    """Return the inertia of a unit mass at r."""
    return r @ r * np.eye(3) - np.outer(r, r)


def _hover_inflow(vehicle: Vehicle) -> float:
    """Return the induced velocity at hover, m/s, by momentum theory, with a radius from the hub positions."""
    hubs = [np.array(rotor.position_m) for rotor in vehicle.rotors]
    nearest = min(float(np.linalg.norm(a - hubs[0])) for a in hubs[1:])
    area = math.pi * (_DISC_SHARE * 0.5 * nearest) ** 2
    return math.sqrt(0.25 * vehicle.mass_kg * GRAVITY_M_S2 / (2.0 * _AIR_DENSITY_KG_M3 * area))


def _dead_zone(vehicle: Vehicle, centre: float, width: float) -> list[float]:
    """Return centre and half width, as motor commands, of a zone whose thrusts are shares of full thrust."""
    c1, c2 = vehicle.thrust_curve

    def command(thrust: float) -> float:
        return 2.0 * thrust / (c1 + math.sqrt(c1 * c1 + 4.0 * c2 * thrust))

    return [command(centre), 0.5 * (command(centre + width) - command(max(centre - width, 0.0)))]


def _of_one_rotor(vehicle: Vehicle, towards: float, size: float) -> list[float]:
    """Return `size` for the rotor nearest to the direction `towards`, rad from x to y, 0 for others."""
    x, y = math.cos(towards), math.sin(towards)
    along = [rotor.position_m[0] * x + rotor.position_m[1] * y for rotor in vehicle.rotors]
    return [size if a == max(along) else 0.0 for a in along]


def _canted(value: Callable[[str, str], float], i: int) -> list[float]:
    """Return the direction of rotor i's thrust in FRD."""
    cant, towards = value("motor-cant", f"cant_{i}"), value("motor-cant", f"towards_{i}")
    side = math.sin(cant)
    return [side * math.cos(towards), side * math.sin(towards), -math.cos(cant)]


def _north_east(towards: float) -> tuple[float, float]:
    return math.cos(towards), math.sin(towards)


def _six(tensor: np.ndarray) -> list[float]:
    return [float(tensor[i, k]) for i, k in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))]
