"""Takeovers: commands of other stations that change a flight, read from the vehicle's status."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from trimtab.protocol import messages as m
from trimtab.protocol.messages import mavlink

COMMANDS = {
    mavlink.TRIMTAB_COMMAND_ARM: "arming",
    mavlink.TRIMTAB_COMMAND_START: "a start",
    mavlink.TRIMTAB_COMMAND_TAKEOFF: "a take-off",
    mavlink.TRIMTAB_COMMAND_HOLD: "hold",
    mavlink.TRIMTAB_COMMAND_OFFBOARD: "offboard",
    mavlink.TRIMTAB_COMMAND_LAND: "a landing",
    mavlink.TRIMTAB_COMMAND_DISARM: "a disarm",
    mavlink.TRIMTAB_COMMAND_KILL: "motors off",
}
"""Commands that change the state of the vehicle, in words."""
OF_REFERENCE = frozenset({mavlink.TRIMTAB_COMMAND_ARM, mavlink.TRIMTAB_COMMAND_START})
"""Commands that a host gives in a flight by the law on board."""
OF_CONTROLLER = frozenset(
    {
        mavlink.TRIMTAB_COMMAND_ARM,
        mavlink.TRIMTAB_COMMAND_TAKEOFF,
        mavlink.TRIMTAB_COMMAND_OFFBOARD,
        mavlink.TRIMTAB_COMMAND_LAND,
    }
)
"""Commands that a host gives in a flight by a controller on the host."""
_ENDING = (
    mavlink.TRIMTAB_STATE_STANDBY,
    mavlink.TRIMTAB_STATE_LANDING,
    mavlink.TRIMTAB_STATE_FAILSAFE,
)
"""States that lead to standby without another command."""


@dataclass(frozen=True, kw_only=True)
class Takeover:
    """A command that changed the state of the vehicle in flight and that this host did not send.

    `command`: the command in words. `system`, `component`: MAVLink address of the station that gave it.
    """

    command: str
    system: int
    component: int

    @property
    def words(self) -> str:
        """Return which station commanded what."""
        station = (self.system, self.component)
        own = station == m.HOST
        whose = ", which has this host's address," if own else ""
        return f"station {m.station_name(station)}{whose} commanded {self.command}"

    def to_json(self) -> dict[str, Any]:
        """Return the entry `takeover` of `trimtab fly --json`."""
        return {"command": self.command, "system": self.system, "component": self.component}


class TakeoverWatch:
    """Finds the first takeover of a flight.

    Attributes
    ----------
    commands
        TRIMTAB_COMMAND values that this host gives. A command of this host's address outside this set is
        another station's.
    takeover
        First takeover; None before one.
    """

    def __init__(self, commands: frozenset[int]) -> None:
        self.commands = set(commands)
        self.takeover: Takeover | None = None
        self._armed = False

    def observe(self, status: m.FcStatus) -> bool:
        """Take a status; return whether another station's command has left the vehicle in the air."""
        self._armed = self._armed or status.state > mavlink.TRIMTAB_STATE_STANDBY
        if not self._armed or not self._is_foreign(status):
            return False
        if self.takeover is None:
            system, component = status.commander
            command = COMMANDS.get(status.command, "another state")
            self.takeover = Takeover(command=command, system=system, component=component)
        return status.state not in _ENDING

    def _is_foreign(self, status: m.FcStatus) -> bool:
        if status.command == mavlink.TRIMTAB_COMMAND_NONE:
            return False
        return tuple(status.commander) != m.HOST or status.command not in self.commands
