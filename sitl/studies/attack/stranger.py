"""A second station that shares the port of a simulated vehicle, in lock-step."""

from __future__ import annotations

from collections.abc import Callable, Iterable

from trimtab.host.link.vehicle import Vehicle
from trimtab.protocol import messages as m
from trimtab.protocol.codec import Codec
from trimtab.protocol.messages import Message
from trimtab.protocol.telemetry import TICK_US

ADDRESS = (77, 190)
"""MAVLink system and component of a stranger."""
STEP_US = 10 * TICK_US
"""Interval at which a stranger acts."""


class Stranger:
    """A station that hears the vehicle and acts every STEP_US.

    Parameters
    ----------
    act
        Called with this object; returns the messages to send now.
    address
        MAVLink system and component, possibly another station's.

    Attributes
    ----------
    now_us
        Present time.
    status, estimate
        Newest FC_STATUS and FC_ESTIMATE; None before the first.
    texts, acks
        Status texts of the vehicle, and (command, result) of the answers to this station.
    state_us
        Time at which the present state was first heard.
    """

    def __init__(
        self, act: Callable[[Stranger], Iterable[Message]], address: tuple[int, int] = ADDRESS
    ) -> None:
        self.now_us = 0
        self.status: m.FcStatus | None = None
        self.estimate: m.FcEstimate | None = None
        self.texts: list[str] = []
        self.acks: list[tuple[int, int]] = []
        self.state_us = 0
        self.due_us = 0
        self._act = act
        self._address = address
        self._codec = Codec(*address)

    @property
    def state(self) -> int:
        """State of the vehicle, TRIMTAB_STATE."""
        return 0 if self.status is None else self.status.state

    def hear(self, data: bytes) -> None:
        """Take bytes of the vehicle."""
        for message in self._codec.decode(data):
            if isinstance(message, m.FcStatus):
                if message.state != self.state:
                    self.state_us = self.now_us
                self.status = message
            elif isinstance(message, m.FcEstimate):
                self.estimate = message
            elif isinstance(message, m.StatusText):
                self.texts.append(message.text)
            elif isinstance(message, m.CommandAck) and self._address == (
                message.target_system,
                message.target_component,
            ):
                self.acks.append((message.command, message.result))

    def act(self, now_us: int) -> bytes:
        """Return the bytes to send at this time."""
        self.now_us, self.due_us = now_us, now_us + STEP_US
        return b"".join(self._codec.encode(message) for message in self._act(self))


class Wrapper:
    """A vehicle around another one; both satisfy `host.link.Vehicle`."""

    def __init__(self, vehicle: Vehicle) -> None:
        self.now_us = vehicle.now_us
        self._vehicle = vehicle

    def run_until(self, t_us: int) -> int:
        """Run until `t_us`, or until bytes or poses wait for the host."""
        self.now_us = self._vehicle.run_until(t_us)
        return self.now_us

    def serial_read(self) -> bytes:
        return self._vehicle.serial_read()

    def serial_write(self, data: bytes) -> None:
        self._vehicle.serial_write(data)

    def mocap_read(self) -> list[bytes]:
        return self._vehicle.mocap_read()

    def power_cycle(self, flight: int) -> None:
        self._vehicle.power_cycle(flight)
        self.now_us = self._vehicle.now_us

    def close(self) -> None:
        self._vehicle.close()


class SharedVehicle(Wrapper):
    """A vehicle whose port the host shares with a stranger."""

    def __init__(self, vehicle: Vehicle, stranger: Stranger) -> None:
        super().__init__(vehicle)
        self._stranger = stranger

    def run_until(self, t_us: int) -> int:
        """Run until `t_us`, until bytes wait for the host, or until the stranger acts."""
        stranger, vehicle = self._stranger, self._vehicle
        self.now_us = vehicle.run_until(min(t_us, max(stranger.due_us, vehicle.now_us + TICK_US)))
        if self.now_us >= stranger.due_us and (data := stranger.act(self.now_us)):
            vehicle.serial_write(data)
        return self.now_us

    def serial_read(self) -> bytes:
        """Return the bytes for the host; the stranger hears them too."""
        data = self._vehicle.serial_read()
        if data:
            self._stranger.hear(data)
        return data

    def power_cycle(self, flight: int) -> None:
        super().power_cycle(flight)
        self._stranger.due_us = 0
