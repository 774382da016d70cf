"""Whether two sets of flights can be compared: one vehicle, no flight in both, the same topics."""

from __future__ import annotations

from collections.abc import Sequence

from trimtab.host.effects.unknowns import TORQUE, undetermined
from trimtab.host.log import Flight, is_same_flight
from trimtab.host.trace.data.signals import unknowns, without_inputs
from trimtab.host.trace.decision.findings import Code, LogsRefused


def check_sets(flights: Sequence[Flight], baseline: Sequence[Flight]) -> None:
    """Raise LogsRefused if `flights` cannot be compared with the flights of the baseline.

    That is so if one is of another vehicle, is in both sets, or if the sets hold different topics.
    """
    for before in baseline:
        if before.vehicle.id != flights[0].vehicle.id:
            raise LogsRefused(
                Code.BASELINE_OF_ANOTHER_VEHICLE,
                f"{before.path}: a baseline of vehicle {before.vehicle.name} ({before.vehicle.id}), but "
                f"{flights[0].path} is of {flights[0].vehicle.name} ({flights[0].vehicle.id}); give flights "
                "of one vehicle file",
            )
        for flight in flights:
            if is_same_flight(flight, before):
                raise LogsRefused(
                    Code.SETS_SHARE_A_FLIGHT,
                    f"{before.path}: the same flight as {flight.path}; give it either as the baseline or "
                    "as a flight after the change",
                )
    first, second = (_topics_of_all(each) for each in (baseline, flights))
    if first != second:
        raise LogsRefused(
            Code.SETS_DIFFER_IN_TOPICS,
            f"the baseline logs {_listed(first)}, the flights after the change {_listed(second)}; give "
            "flights that log the same",
        )


def _topics_of_all(flights: Sequence[Flight]) -> frozenset[str]:
    """Return what every one of the flights logs of inputs and IMU."""
    return frozenset.intersection(*map(_topics, flights))


def _topics(flight: Flight) -> frozenset[str]:
    """Return what a flight logs of inputs and IMU, as words."""
    if flight.control is not None:
        return frozenset({"motor commands", "gyro", "specific force"})
    topics = set()
    recorded, imu = flight.recorded_inputs, flight.recorded_imu
    if recorded is not None and not without_inputs(flight):
        topics.add("thrust" if recorded.motor is None else "motor commands")
    if imu is not None:
        topics |= {"gyro"} if imu.gyro is not None else set()
        topics |= {"specific force"} if imu.specific_force is not None else set()
    return frozenset(topics)


def _listed(topics: frozenset[str]) -> str:
    return ", ".join(sorted(topics)) or "only poses"


def unknowns_of_change(flights: Sequence[Flight]) -> frozenset[str]:
    """Return what the logs of both sets leave unknown, without a torque that differences determine.

    A vehicle file need not be exact in its inertia and torque: both sets have the error in common. So logs
    that declare the torque unknown, but hold fast enough motor commands, show a change of the torque.
    """
    words = unknowns(flights)
    fast = all(
        flight.control is not None
        or (
            flight.recorded_inputs is not None
            and flight.recorded_inputs.motor is not None
            and not undetermined(flight.recorded_inputs.t_us, flight.vehicle.motor_lag_s)
        )
        for flight in flights
    )
    return words - {TORQUE} if fast else words
