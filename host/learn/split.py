"""Flights to learn from and flights held out for the test."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Literal

import numpy as np

from trimtab.host.learn.ahead import ahead
from trimtab.host.learn.candidates import Candidate, Trial
from trimtab.host.learn.evaluate import Errors, whole_flights
from trimtab.host.log import Flight, is_same_flight
from trimtab.host.log.errors import TooLittleData
from trimtab.host.models.states import States, flight_states


@dataclass(frozen=True, kw_only=True)
class Split:
    """Flights to learn from and flights held out, and the logs of both by flight id.

    latency_s: how much older poses are than stamped, as the model learned upon has it. test_drive: what
    predicts the flights held out: their references or, if controllers on the host flew, their inputs.
    """

    used: list[States]
    test: list[States]
    logs: Mapping[str, Flight]
    latency_s: float
    test_drive: Literal["reference", "inputs"]

    @classmethod
    def of(
        cls,
        flights: Sequence[Flight],
        hold_out: Sequence[Flight] | None,
        latency_s: float,
        rng: np.random.Generator,
    ) -> Split:
        """Return the flights; None as `hold_out` splits them by reference.

        Raises TooLittleData for flights of two vehicles, for a flight given twice, for a reference on both
        sides, and for flights by a controller on the host that are not held out, or held out beside others.
        """
        every = [*flights, *(hold_out or ())]
        _check_one_vehicle(every)
        _check_distinct(every)
        test_drive = _check_controllers(flights, hold_out or ())
        used = flight_states(flights, latency_s=latency_s)
        if hold_out is None:
            used, test = split_by_reference(used, rng)
        else:
            test = flight_states(hold_out, latency_s=latency_s)
            shared = {s.reference_id for s in test} & {s.reference_id for s in used}
            if shared:
                names = ", ".join(sorted(shared))
                raise TooLittleData(
                    f"held-out flights share the reference {names} with the others; hold out others"
                )
        logs = {flight.id: flight for flight in every}
        return cls(used=used, test=test, logs=logs, latency_s=latency_s, test_drive=test_drive)

    def trial(self, candidate: Candidate) -> Trial:
        """Return the candidate's errors on whole flights, or as `test_drive` says on those held out."""
        train = whole_flights(
            candidate.phi, candidate.theta, self._states(candidate, self.used), candidate.network
        )
        return Trial(what=candidate.what, train=train, test=self.test_errors(candidate))

    def test_errors(self, candidate: Candidate) -> Errors | None:
        """Return the candidate's errors on the flights held out; None if there are none."""
        if not self.test:
            return None
        states = self._states(candidate, self.test)
        if self.test_drive == "reference":
            return whole_flights(candidate.phi, candidate.theta, states, candidate.network)
        logs = [self.logs[each.flight_id] for each in states]
        return ahead(candidate.phi, candidate.theta, states, logs, candidate.network)

    def _states(self, candidate: Candidate, chosen: Sequence[States]) -> Sequence[States]:
        """Return the states of the chosen flights with the candidate's latency of the poses."""
        if candidate.latency_s == self.latency_s:
            return chosen
        return flight_states([self.logs[s.flight_id] for s in chosen], latency_s=candidate.latency_s)


def split_by_reference(
    states: Sequence[States], rng: np.random.Generator
) -> tuple[list[States], list[States]]:
    """Return flights to learn from and flights held out: every fourth reference, of three or more."""
    references = sorted({s.reference_id for s in states})
    if len(references) < 3:
        return list(states), []
    shuffled = [references[i] for i in rng.permutation(len(references))]
    held = set(shuffled[: max(1, len(references) // 4)])
    return (
        [s for s in states if s.reference_id not in held],
        [s for s in states if s.reference_id in held],
    )


def _check_controllers(
    flights: Sequence[Flight], hold_out: Sequence[Flight]
) -> Literal["reference", "inputs"]:
    """Return what predicts the flights held out. Raises TooLittleData if learning cannot use the flights."""
    by_host = next((flight for flight in flights if flight.host_control is not None), None)
    if by_host is not None:
        raise TooLittleData(
            f"{by_host.path.name}: flown by a controller on the host, and learning predicts flights by the "
            "law on board; give it with --hold-out"
        )
    kinds = {flight.host_control is not None for flight in hold_out}
    if len(kinds) > 1:
        raise TooLittleData(
            "flights by the law on board and by a controller on the host are held out together; their errors "
            "are of different kinds, hold out one kind"
        )
    return "inputs" if True in kinds else "reference"


def _check_one_vehicle(flights: Sequence[Flight]) -> None:
    if not flights:
        raise TooLittleData("no flights to learn from; name one or more logs")
    first = flights[0]
    for flight in flights[1:]:
        if flight.vehicle.id != first.vehicle.id:
            one, other = (f"{f.vehicle.name} ({f.vehicle.id})" for f in (flight, first))
            raise TooLittleData(
                f"{flight.path.name} is of vehicle {one}, {first.path.name} of {other}; "
                "learn from one vehicle at a time"
            )
        if flight.firmware_parameters != first.firmware_parameters:
            raise TooLittleData(
                f"{flight.path.name} flew with other firmware parameters than {first.path.name}; "
                "learn from flights of one setting"
            )


def _check_distinct(flights: Sequence[Flight]) -> None:
    """Raise TooLittleData if two of the logs hold the same flight."""
    for earlier, flight in combinations(flights, 2):
        if is_same_flight(earlier, flight):
            raise TooLittleData(f"{flight.path}: the same flight as {earlier.path}; give it once")
