"""Check whether a command that the state machine allows may take effect."""

from __future__ import annotations

import math
from collections.abc import Sequence

from trimtab.firmware_model.flight.condition_monitor import ConditionMonitor, fence
from trimtab.firmware_model.flight.estimate import Estimate
from trimtab.firmware_model.flight.parameters import ParameterValues
from trimtab.firmware_model.flight.phases import TAKEOFF_HEIGHT_MIN, Phases
from trimtab.firmware_model.flight.readiness import (
    ArmingState,
    StillnessDetector,
    arming_refusals,
    contradiction,
    start_refusal,
)
from trimtab.firmware_model.flight.supervisor import Event, State
from trimtab.firmware_model.flight.track import Track
from trimtab.firmware_model.flight.verdict import battery_verdict

POSES_IN_A_ROW = 5
"""Least number of poses in a row before arming: one alone may be from another source, or very late."""


class CommandGate:
    """Refuses commands that the present condition of the vehicle does not allow, with a reason.

    memory, cos_tilt: views of the engine's memory and output.
    """

    def __init__(
        self,
        *,
        parameters: ParameterValues,
        monitor: ConditionMonitor,
        estimate: Estimate,
        stillness: StillnessDetector,
        phases: Phases,
        memory: Sequence[float],
        cos_tilt: Sequence[float],
    ) -> None:
        self._parameters = parameters
        self._monitor = monitor
        self._estimate = estimate
        self._stillness = stillness
        self._phases = phases
        self._memory = memory
        self._cos_tilt = cos_tilt

    def refusal(
        self,
        event: Event,
        now_us: int,
        *,
        state: State,
        reference: Track | None,
        to_reference: bool,
        flown: bool,
    ) -> str | None:
        """Return why a command that the state machine allows is refused, or None.

        to_reference: whether a take-off leads to the reference. flown: whether the reference was tracked.
        """
        if event is Event.ARM and state is State.STANDBY:
            return next(iter(self.arming_reasons(now_us, reference)), None)
        if event is Event.START and state in (State.ARMED, State.TAKEOFF, State.HOLD):
            taking_off = state is State.TAKEOFF
            if taking_off and to_reference:
                return None  # a repetition of the same command
            battery = self._battery(reference)
            return start_refusal(reference, to_hover=taking_off, flown=flown, battery=battery)
        if (
            event is Event.TAKEOFF
            and state is State.ARMED
            and self._phases.ceiling_distance < TAKEOFF_HEIGHT_MIN
        ):
            return f"fence less than {TAKEOFF_HEIGHT_MIN:g} m above"
        if event is Event.OFFBOARD and not self._phases.offboard.is_receiving(now_us):
            return "no setpoints: stream them first"
        return None

    def arming_reasons(self, now_us: int, reference: Track | None) -> list[str]:
        """Return every reason why arming would be refused in standby."""
        memory, values = self._memory, self._parameters
        state = ArmingState(
            calibrated=self._estimate.calibration.bias is not None,
            has_pose=self.has_pose(now_us) and self._estimate.in_a_row >= POSES_IN_A_ROW,
            still=self._stillness.still,
            pose_tilt_deg=self._stillness.pose_tilt_deg,
            pose_tilt_max_deg=values["ARM_ASKEW_DEG"],
            cos_tilt=self._cos_tilt[0],
            cos_tilt_min=math.cos(math.radians(values["ARM_TILT_DEG"])),
            p=(memory[0], memory[1], memory[2]),
            fence=fence(values),
            active=frozenset(row.event for row in self._monitor.active_conditions()),
            battery=self._battery(reference),
            contradiction=contradiction(values),
            lacks_key=values["SIGN_REQUIRED"] > 0.0 and not self._monitor.has_key,
        )
        return arming_refusals(state)

    def has_pose(self, now_us: int) -> bool:
        """Return whether poses arrive."""
        monitor = self._monitor
        return self._estimate.poses.used > 0 and now_us - monitor.pose_us <= monitor.pose_lost_us

    def _battery(self, reference: Track | None) -> str | None:
        """Return why the live reference may not be flown with this battery, or None."""
        volts = self._monitor.volts
        if reference is None or volts is None:
            return None
        verdict = battery_verdict(self._parameters, volts)
        return None if verdict is None else verdict.message
