"""Flights to learn from and flights held out for the test."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from trimtab.host.learn.candidates import Candidate, Trial
from trimtab.host.learn.evaluate import Errors, whole_flights
from trimtab.host.log import Flight
from trimtab.host.log.errors import TooLittleData
from trimtab.host.models.states import States, flight_states


@dataclass(frozen=True, kw_only=True)
class Split:
    """Flights to learn from and flights held out, and the logs of both by flight id.

    latency_s: how much older poses are than stamped, as the model learned upon has it.
    """

    used: list[States]
    test: list[States]
    logs: Mapping[str, Flight]
    latency_s: float

    @classmethod
    def of(
        cls,
        flights: Sequence[Flight],
        hold_out: Sequence[Flight] | None,
        latency_s: float,
        rng: np.random.Generator,
    ) -> Split:
        """Return the flights; None as `hold_out` splits them by reference.

        Raises TooLittleData for flights of two vehicles, and for a reference on both sides.
        """
        _check_one_vehicle([*flights, *(hold_out or ())])
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
        logs = {flight.id: flight for flight in [*flights, *(hold_out or ())]}
        return cls(used=used, test=test, logs=logs, latency_s=latency_s)

    def trial(self, candidate: Candidate) -> Trial:
        """Return the candidate's errors on whole flights."""
        train = self._errors(candidate, self.used)
        test = self._errors(candidate, self.test) if self.test else None
        return Trial(what=candidate.what, train=train, test=test)

    def _errors(self, candidate: Candidate, chosen: Sequence[States]) -> Errors:
        if candidate.latency_s != self.latency_s:
            flights = [self.logs[s.flight_id] for s in chosen]
            chosen = flight_states(flights, latency_s=candidate.latency_s)
        return whole_flights(candidate.phi, candidate.theta, chosen, candidate.network)


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
