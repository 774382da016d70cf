"""Parameter messages: list all values, read one value, and set a value in standby."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable

from trimtab.firmware_model.flight.flight import Flight
from trimtab.firmware_model.flight.parameters import ParameterValues, index_of, name_at
from trimtab.firmware_model.flight.supervisor import State
from trimtab.firmware_model.services.global_position import Place, origin_parameters
from trimtab.firmware_model.services.ownership import Ownership
from trimtab.protocol import messages as m
from trimtab.protocol.messages import Message, Station, mavlink, station_name
from trimtab.protocol.parameter_wire import REAL32, decode, encode, type_of
from trimtab.protocol.parameters import BY_NAME

VALUES_PER_UPDATE = 2
"""Number of PARAM_VALUE messages of a list in each update: 200 per second."""
OTHERS_US = 5_000_000
"""A change is reported to the stations heard within this time, unless only its sender was."""
_WARNING = mavlink.MAV_SEVERITY_WARNING
_TYPE_NAMES = {True: "INT32", False: "REAL32"}


class ParameterService:
    """Handlers of PARAM_ messages.

    Parameters
    ----------
    send
        Sends a message.
    text
        Sends severity and text to the host.
    on_set
        Receives name and value of a parameter that was set.
    on_limits
        Called after a change of the limits or the airframe that references are checked against.
    """

    def __init__(
        self,
        *,
        flight: Flight,
        ownership: Ownership,
        parameters: ParameterValues,
        send: Callable[[Message], None],
        text: Callable[[int, str], None],
        on_set: Callable[[str, float], None],
        on_limits: Callable[[], None],
    ) -> None:
        self._flight = flight
        self._ownership = ownership
        self._parameters = parameters
        self._send = send
        self._text = text
        self._on_set = on_set
        self._on_limits = on_limits
        self._listing: deque[int] = deque()

    def update(self) -> None:
        """Send the next entries of a requested list."""
        for _ in range(min(VALUES_PER_UPDATE, len(self._listing))):
            self._send_value(self._listing.popleft())

    def list(self, message: m.ParamRequestList, now_us: int) -> None:
        """Queue all values; each update sends a few of them.

        Every station receives the values. If a list is already in progress, its remaining values serve both
        requests, and the values already sent are appended.
        """
        waiting = set(self._listing)
        self._listing.extend(index for index in range(len(self._parameters)) if index not in waiting)

    def read(self, message: m.ParamRequestRead, now_us: int) -> None:
        """Send one value, or PARAM_ERROR if the parameter does not exist."""
        index = message.param_index if message.param_index >= 0 else index_of(message.param_id)
        if index is not None and name_at(index) is not None:
            self._send_value(index)
        else:
            self._send_error(message, message.param_index, mavlink.MAV_PARAM_ERROR_DOES_NOT_EXIST)

    def set(self, message: m.ParamSet, now_us: int) -> None:
        """Set a parameter, in standby only, and answer with the value on board, also after a refusal.

        After a refusal, PARAM_ERROR precedes the value. A whole number may also arrive as REAL32: MAVProxy
        sends all parameters in this way.
        """
        name = message.param_id
        index = index_of(name)
        if index is None:
            self._text(_WARNING, f"no parameter {name}")
            self._send_error(message, -1, mavlink.MAV_PARAM_ERROR_DOES_NOT_EXIST)
            return
        error: int | None = None
        if self._flight.state is not State.STANDBY:
            self._text(_WARNING, f"{name} kept: set in standby only")
            error = mavlink.MAV_PARAM_ERROR_PERMISSION_DENIED
        elif message.param_type not in (REAL32, type_of(BY_NAME[name])):
            self._text(_WARNING, f"{name} kept: set it as {_TYPE_NAMES[BY_NAME[name].integer]}")
            error = mavlink.MAV_PARAM_ERROR_VALUE_OUT_OF_RANGE
        elif not self._set(
            name, decode(message.param_value, message.param_type), m.sender_of(message), now_us
        ):
            error = mavlink.MAV_PARAM_ERROR_VALUE_OUT_OF_RANGE
        if error is not None:
            self._send_error(message, -1, error)
        self._send_value(index)

    def set_origin(self, place: Place, station: Station, now_us: int) -> None:
        """Set the place of the local frame's origin, in standby only. A text says why it was refused."""
        values = origin_parameters(place)
        if self._flight.state is not State.STANDBY:
            self._text(_WARNING, "origin kept: set in standby only")
            return
        try:
            for name, value in values.items():
                BY_NAME[name].check(value)
        except ValueError as error:
            self._text(_WARNING, str(error))
            return
        for name, value in values.items():
            self._set(name, value, station, now_us)

    def _set(self, name: str, value: float, station: Station, now_us: int) -> bool:
        """Set a value; return False after a refusal, whose reason a text gives."""
        parameters = self._parameters
        before, value_before = (parameters.airframe, parameters.limits), parameters[name]
        try:
            self._on_set(name, parameters.set(name, value))
        except ValueError as error:
            self._text(_WARNING, str(error))
            return False
        self._flight.configure()
        changed = parameters[name] != value_before
        if changed and self._ownership.other_stations(station, now_us, OTHERS_US):
            text = f"{name} set to {parameters[name]:g} by station {station_name(station)}"
            self._text(mavlink.MAV_SEVERITY_NOTICE, text)
        if (parameters.airframe, parameters.limits) != before:
            self._on_limits()
        return True

    def _send_error(self, request: m.ParamSet | m.ParamRequestRead, index: int, error: int) -> None:
        self._send(m.ParamError(*m.sender_of(request), request._param_id_raw, index, error))

    def _send_value(self, index: int) -> None:
        name = name_at(index)
        if name is not None:
            value, count = self._parameters[name], len(self._parameters)
            kind = type_of(BY_NAME[name])
            self._send(m.ParamValue(name.encode(), encode(value, kind), kind, count, index))
