"""Decide whether a command that the state machine allows may take effect."""

from __future__ import annotations

import math
from collections.abc import Sequence

from trimtab.firmware_model.flight.estimate import Estimate
from trimtab.firmware_model.flight.parameters import ParameterValues
from trimtab.firmware_model.flight.phases import TAKEOFF_LEAST, Phases
from trimtab.firmware_model.flight.readiness import Facts, Rest, contradiction, reasons, start_refusal
from trimtab.firmware_model.flight.supervisor import Event, State
from trimtab.firmware_model.flight.track import Track
from trimtab.firmware_model.flight.verdict import battery_verdict
from trimtab.firmware_model.flight.watch import Watch, fence


class Gate:
    """Refuses commands, with a reason, by the present condition of the vehicle.

    memory, cos_tilt: views of the law's memory and output.
    """

    def __init__(
        self,
        *,
        parameters: ParameterValues,
        watch: Watch,
        estimate: Estimate,
        rest: Rest,
        phases: Phases,
        memory: Sequence[float],
        cos_tilt: Sequence[float],
    ) -> None:
        self._parameters = parameters
        self._watch = watch
        self._estimate = estimate
        self._rest = rest
        self._phases = phases
        self._memory = memory
        self._cos_tilt = cos_tilt

    def refusal(
        self, event: Event, now_us: int, *, state: State, reference: Track | None, climbing: bool, flown: bool
    ) -> str | None:
        """Return why a command is refused that the state machine allows; None if it is not.

        climbing: whether a take-off leads to the reference. flown: whether the reference was tracked.
        """
        if event is Event.ARM and state is State.STANDBY:
            return next(iter(self.arming_reasons(now_us, reference)), None)
        if event is Event.START and state in (State.ARMED, State.TAKEOFF, State.HOLD):
            rising = state is State.TAKEOFF
            if rising and climbing:
                return None  # a repetition of the same command
            battery = self._battery(reference)
            return start_refusal(reference, rising=rising, flown=flown, battery=battery)
        if event is Event.TAKEOFF and state is State.ARMED and self._phases.headroom < TAKEOFF_LEAST:
            return f"fence less than {TAKEOFF_LEAST:g} m above"
        if event is Event.OFFBOARD and not self._phases.offboard.arriving(now_us):
            return "no setpoints: stream them first"
        return None

    def arming_reasons(self, now_us: int, reference: Track | None) -> list[str]:
        """Return every reason why arming would be refused in standby."""
        memory, values = self._memory, self._parameters
        facts = Facts(
            calibrated=self._estimate.calibration.bias is not None,
            posed=self.has_pose(now_us),
            still=self._rest.still,
            askew_deg=self._rest.askew_deg,
            askew_max_deg=values["ARM_ASKEW_DEG"],
            cos_tilt=self._cos_tilt[0],
            cos_tilt_min=math.cos(math.radians(values["ARM_TILT_DEG"])),
            p=(memory[0], memory[1], memory[2]),
            fence=fence(values),
            holding=frozenset(row.event for row in self._watch.holding()),
            battery=self._battery(reference),
            contradiction=contradiction(values),
        )
        return reasons(facts)

    def has_pose(self, now_us: int) -> bool:
        """Return whether poses arrive."""
        watch = self._watch
        return self._estimate.poses.used > 0 and now_us - watch.pose_us <= watch.pose_lost_us

    def _battery(self, reference: Track | None) -> str | None:
        """Return why the live reference is not flown with this battery."""
        volts = self._watch.volts
        if reference is None or volts is None:
            return None
        verdict = battery_verdict(self._parameters, volts)
        return None if verdict is None else verdict.message
