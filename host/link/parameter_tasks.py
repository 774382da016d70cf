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
    """Result: all parameters on board by name. Raises LinkError where they do not arrive."""

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
        # While the list flows nothing is asked again.
        self.deadline_us = now_us + RETRY_US
        if len(self._values) == self._count:
            self.finish(dict(self._values[index] for index in sorted(self._values)))

    def advance(self, client: Client, now_us: int) -> None:
        if now_us - self._progress_us >= self._patience_us:
            what = "none" if self._count is None else f"{len(self._values)} of {self._count}"
            raise LinkError(f"the vehicle's parameters do not arrive ({what} did); check the link")
        if self._count is None:
            self._list(client, now_us)
            return
        missing = [index for index in range(self._count) if index not in self._values]
        for index in missing[:8]:
            client.send(m.ParamRequestRead(*m.VEHICLE, b"", index))
        self.deadline_us = now_us + RETRY_US


class SetParameter(Task):
    """Result: the value on board. Raises Refused where the vehicle keeps another, LinkError on silence.

    Values are the same where they are in float32. ValueError where it is not finite, or no whole number where
    the table asks for one.
    """

    wants = (m.ParamValue,)

    def __init__(self, name: str, value: float, attempts: int = 10) -> None:
        super().__init__()
        if not 0 < len(name) <= NAME_MAX or not name.isascii():
            raise ValueError(f"a parameter's name has 1 to {NAME_MAX} ASCII characters, not {name!r}")
        self._name = name
        self._value = float32(value)
        self._type = type_of(BY_NAME.get(name))
        self._raw = encode(self._value, self._type)
        self._attempts = attempts

    def begin(self, client: Client, now_us: int) -> None:
        self._said = client.said
        self.advance(client, now_us)

    def advance(self, client: Client, now_us: int) -> None:
        if self._attempts == 0:
            raise LinkError(f"{self._name} was set but the vehicle does not answer; check the link")
        self._attempts -= 1
        client.send(m.ParamSet(*m.VEHICLE, self._name.encode(), self._raw, self._type))
        self.deadline_us = now_us + RETRY_US

    def receive(self, client: Client, message: Message, now_us: int) -> None:
        assert isinstance(message, m.ParamValue)
        if message.param_id != self._name:
            return
        value = _value(message)
        if not isfinite(value) or not equal(value, self._value):
            said = " ".join(client.said_since(self._said))
            raise Refused(f"{self._name} stays {value:g} on board" + (f" ({said})" if said else ""))
        self.finish(value)


def _value(message: m.ParamValue) -> float:
    """Return the value that a PARAM_VALUE stands for.

    Raises LinkError where its type is none that we know.
    """
    try:
        return decode(message.param_value, message.param_type)
    except ValueError as error:
        raise LinkError(f"{message.param_id} comes in a type we do not know ({error})") from None
