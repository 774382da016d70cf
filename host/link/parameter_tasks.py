"""Tasks that read and set parameters on board."""

from __future__ import annotations

from math import isfinite

from trimtab.host.base.errors import LinkError, Refused
from trimtab.host.link.client import Client
from trimtab.host.link.tasks import PATIENCE_US, RETRY_US, Task
from trimtab.protocol import messages as m
from trimtab.protocol.messages import Message
from trimtab.protocol.parameter_wire import decode, encode, type_of
from trimtab.protocol.parameters import BY_NAME, NAME_MAX, equal, float32


class ReadParameters(Task):
    """Read all parameters on board. The result maps names to values. Raises LinkError if some are missing."""

    wants = (m.ParamValue,)

    def __init__(self, patience_us: int = PATIENCE_US) -> None:
        super().__init__()
        self._patience_us = patience_us
        self._values: dict[int, tuple[str, float]] = {}
        self._count: int | None = None
        self._progress_us = 0

    def begin(self, client: Client, now_us: int) -> None:
        self._progress_us = now_us
        self._list(client, now_us)

    def _list(self, client: Client, now_us: int) -> None:
        client.send(m.ParamRequestList(*m.VEHICLE))
        self.deadline_us = now_us + RETRY_US

    def receive(self, client: Client, message: Message, now_us: int) -> None:
        assert isinstance(message, m.ParamValue)
        if message.param_index >= message.param_count:
            return
        self._count = message.param_count
        if message.param_index not in self._values:
            self._progress_us = now_us
        self._values[message.param_index] = (message.param_id, _value(message))
        # Request missing parameters only after the list has stopped.
        self.deadline_us = now_us + RETRY_US
        if len(self._values) == self._count:
            self.finish(dict(self._values[index] for index in sorted(self._values)))

    def advance(self, client: Client, now_us: int) -> None:
        if now_us - self._progress_us >= self._patience_us:
            received = "none" if self._count is None else f"{len(self._values)} of {self._count}"
            raise LinkError(f"the vehicle's parameters do not arrive ({received} did); check the link")
        if self._count is None:
            self._list(client, now_us)
            return
        missing = [index for index in range(self._count) if index not in self._values]
        for index in missing[:8]:
            client.send(m.ParamRequestRead(*m.VEHICLE, b"", index))
        self.deadline_us = now_us + RETRY_US


class SetParameter(Task):
    """Set a parameter on board. The result is the value that the vehicle confirms.

    Values are compared as float32. Raises Refused if the vehicle keeps another value, and LinkError if it
    does not answer. Raises ValueError if the value is not finite, or not whole for an integer parameter.
    """

    wants = (m.ParamValue,)

    def __init__(self, name: str, value: float, attempts: int = 10) -> None:
        super().__init__()
        if not 0 < len(name) <= NAME_MAX or not name.isascii():
            raise ValueError(f"a parameter name has 1 to {NAME_MAX} ASCII characters, not {name!r}")
        self._name = name
        self._value = float32(value)
        self._type = type_of(BY_NAME.get(name))
        self._raw = encode(self._value, self._type)
        self._attempts = attempts

    def begin(self, client: Client, now_us: int) -> None:
        self._texts_before = client.text_count
        self.advance(client, now_us)

    def advance(self, client: Client, now_us: int) -> None:
        if self._attempts == 0:
            raise LinkError(f"{self._name}: the vehicle does not confirm the new value; check the link")
        self._attempts -= 1
        client.send(m.ParamSet(*m.VEHICLE, self._name.encode(), self._raw, self._type))
        self.deadline_us = now_us + RETRY_US

    def receive(self, client: Client, message: Message, now_us: int) -> None:
        assert isinstance(message, m.ParamValue)
        if message.param_id != self._name:
            return
        value = _value(message)
        if not isfinite(value) or not equal(value, self._value):
            reason = " ".join(client.texts_since(self._texts_before))
            raise Refused(f"{self._name} stays {value:g} on board" + (f" ({reason})" if reason else ""))
        self.finish(value)


def _value(message: m.ParamValue) -> float:
    """Return the value of a PARAM_VALUE message. Raises LinkError if its type is unknown."""
    try:
        return decode(message.param_value, message.param_type)
    except ValueError as error:
        raise LinkError(f"{message.param_id} has an unknown type ({error})") from None
