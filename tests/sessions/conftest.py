"""References and flights for whole sessions: host, radio, firmware model and plant together."""

from __future__ import annotations

import json
import math
import socket
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from trimtab.host import cli
from trimtab.host.base import output
from trimtab.host.link.flight_request import FlightRequest
from trimtab.host.link.fly import fly_lockstep
from trimtab.host.link.summary import FlightResult
from trimtab.host.link.vehicle import vehicle_class
from trimtab.host.log import Flight, read_flight
from trimtab.host.models.file import write_model
from trimtab.host.models.model import Assessment, Model
from trimtab.host.vehicle import Vehicle, load_vehicle
from trimtab.protocol.blobs import Node, Reference

# A polynomial of degree 9 from 0 to 1 whose first four derivatives vanish at both ends.
_SMOOTH = (0.0, 0.0, 0.0, 0.0, 0.0, 126.0, -420.0, 540.0, -315.0, 70.0)


def figure_eight(vehicle: Vehicle, *, duration_s: float = 6.0, size_m: float = 0.7) -> Reference:
    """A lemniscate at 1.2 m, from rest to rest; its derivatives by the chain rule at every 0.1 s."""
    nodes = []
    for k in range(round(duration_s * 10) + 1):
        x = k / (duration_s * 10)
        a, a1, a2, a3 = (
            2.0
            * math.pi
            / duration_s**d
            * sum(math.perm(i, d) * c * x ** (i - d) for i, c in enumerate(_SMOOTH) if i >= d)
            for d in range(4)
        )

        def chain(
            f: float, f1: float, f2: float, f3: float, a1: float = a1, a2: float = a2, a3: float = a3
        ) -> tuple[float, ...]:
            return f, f1 * a1, f2 * a1**2 + f1 * a2, f3 * a1**3 + 3.0 * f2 * a1 * a2 + f1 * a3

        s, c, s2, c2 = math.sin(a), math.cos(a), math.sin(2 * a), math.cos(2 * a)
        north = chain(size_m * s, size_m * c, -size_m * s, -size_m * c)
        east = chain(size_m / 2 * s2, size_m * c2, -2 * size_m * s2, -4 * size_m * c2)
        state = tuple(axis[d] for d in range(4) for axis in (north, east, (0.0, 0.0, 0.0, 0.0)))
        nodes.append(Node(100_000 * k, state))
    return Reference(vehicle_id=vehicle.id, origin_ned=(0.0, 0.0, -1.2), nodes=tuple(nodes))


@pytest.fixture(scope="session")
def vehicle() -> Vehicle:
    return load_vehicle("research")


@pytest.fixture(scope="session")
def reference(vehicle: Vehicle) -> Reference:
    return figure_eight(vehicle)


@pytest.fixture(scope="session", name="figure_eight")
def _figure_eight() -> Callable[..., Reference]:
    return figure_eight


@pytest.fixture
def run_trimtab(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> Callable[..., tuple[int, dict[str, Any], str]]:
    """Runs the command line in the test's folder: exit code, the JSON of the last line, stderr."""
    monkeypatch.chdir(tmp_path)

    def run(*words: str) -> tuple[int, dict[str, Any], str]:
        monkeypatch.setattr(output, "_emitted", False)
        monkeypatch.setattr("sys.argv", ["trimtab", *words])
        capsys.readouterr()
        code = cli.main(words)
        told = capsys.readouterr()
        last = told.out.strip().splitlines()[-1:] or [""]
        return code, json.loads(last[0]) if last[0].startswith("{") else {}, told.err

    return run


@pytest.fixture
def trimtab(
    run_trimtab: Callable[..., tuple[int, dict[str, Any], str]],
) -> Callable[..., dict[str, Any]]:
    """Runs the command line in the test's folder, which is the workspace: the JSON of its last line."""

    def run(*words: str) -> dict[str, Any]:
        code, told, complaint = run_trimtab(*words, "--json")
        assert code == 0, complaint
        return told

    return run


@pytest.fixture
def drag_model(vehicle: Vehicle, tmp_path: Path) -> str:
    """A model of linear drag, written to drag.model.toml in the test's folder."""
    drag = {"linear-drag": {"dx": 0.4, "dy": 0.35, "dz": 0.2}}
    model = Model(
        vehicle_id=vehicle.id,
        vehicle_name=vehicle.name,
        effects=drag,
        assessment=Assessment(verdict="traced"),
    )
    write_model(model, tmp_path / "drag.model.toml")
    return "drag.model.toml"


@pytest.fixture
def mocap_url() -> str:
    """Where cameras may send their poses: a UDP port that nobody uses, another for every test."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        return f"udp://127.0.0.1:{probe.getsockname()[1]}"


@pytest.fixture
def simulate(vehicle: Vehicle) -> Callable[..., Any]:
    """A simulated vehicle in the empty world unless told otherwise."""

    def create(**options: Any) -> Any:
        return vehicle_class().create(options.pop("vehicle", vehicle), **options)

    return create


@pytest.fixture
def fly(
    vehicle: Vehicle, reference: Reference, simulate: Callable[..., Any], tmp_path: Path
) -> Callable[..., FlightResult]:
    """Flies the reference and logs to flight.mcap in the test's folder."""

    def run(simulated: Any = None, **order: Any) -> FlightResult:
        order = {"vehicle": vehicle, "reference": reference, "log_path": tmp_path / "flight.mcap"} | order
        on_phase = order.pop("on_phase", None)
        return fly_lockstep(FlightRequest(**order), simulated or simulate(), on_phase=on_phase)

    return run


@pytest.fixture(scope="session")
def flown(
    vehicle: Vehicle, reference: Reference, tmp_path_factory: pytest.TempPathFactory
) -> tuple[FlightResult, Flight]:
    """One flight in the empty world, for all tests that only look at what it left."""
    log = tmp_path_factory.mktemp("flown") / "flight.mcap"
    order = FlightRequest(vehicle=vehicle, reference=reference, log_path=log)
    result = fly_lockstep(order, vehicle_class().create(vehicle))
    return result, read_flight(log)


@pytest.fixture
def world_file(tmp_path: Path) -> Callable[[str], str]:
    """The path of an otherwise empty world with a TOML text of its own."""

    def write(text: str) -> str:
        path = tmp_path / "world.toml"
        path.write_text(f'description = "For a test"\ntolerances = true\n{text}', encoding="utf-8")
        return str(path)

    return write
