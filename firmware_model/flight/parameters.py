"""Parameter values on board: protocol's table at run time, and what the law wants made of it.

Values are float32, as they travel. A value that the table or the law refuses leaves everything as it was.
"""

from __future__ import annotations

from array import array
from collections.abc import Iterator, Mapping

from trimtab.firmware_model.law.limits import from_parameters
from trimtab.firmware_model.law.step import parameter_vector
from trimtab.firmware_model.storage.store import ReferenceStore
from trimtab.protocol.parameters import BY_NAME, INDEX, PARAMETERS, complete


class ParameterValues(Mapping[str, float]):
    """Values by name, in the table's order.

    `vector` is the law's block `parameters`: values and the allocation derived from them; `airframe` and
    `limits` are what references are checked by.
    Raises ValueError where a name is unknown, a value out of bounds, a torque beyond the rotors' geometry, or
    a lower limit not below its upper one.
    """

    def __init__(self, values: Mapping[str, float]) -> None:
        self._values = complete(values)
        self.vector = array("d", parameter_vector(self._values))
        self.airframe, self.limits = from_parameters(self._values)

    def __getitem__(self, name: str) -> float:
        return self._values[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._values)

    def __len__(self) -> int:
        return len(self._values)

    def set(self, name: str, value: float) -> float:
        """Return the value now on board, `value` rounded to float32.

        Raises KeyError for an unknown name, ValueError where the value is refused; nothing has changed then.
        """
        rounded = BY_NAME[name].check(value)
        changed = {**self._values, name: rounded}
        try:
            vector = array("d", parameter_vector(changed))
            judged_by = from_parameters(changed)
        except ValueError as error:
            raise ValueError(f"{name}: {error}") from None
        self._values, self.vector = changed, vector
        self.airframe, self.limits = judged_by
        return rounded

    def us(self, name: str) -> int:
        """Return a parameter in seconds as whole microseconds."""
        return round(1e6 * self._values[name])


def stored_parameters(
    values: Mapping[str, float], store: ReferenceStore, vehicle_id: bytes
) -> ParameterValues:
    """`values`, with what was set before in their place; memory of another vehicle is claimed for this one.

    What cannot be used is told in `store.faults`. Raises ValueError where `values` themselves are refused.
    """
    settings = store.settings
    if settings.vehicle_id != vehicle_id:
        if settings.vehicle_id is not None:
            store.faults.append(f"parameters set for vehicle {settings.vehicle_id.hex()}: not used")
        settings.keep(vehicle_id, {})
    try:
        return ParameterValues({**values, **settings.values})
    except ValueError:
        store.faults.append("memory: parameters that were set do not fit")
    return ParameterValues(values)


def name_at(index: int) -> str | None:
    """Name of the parameter at this place in the table, None beyond it."""
    return PARAMETERS[index].name if 0 <= index < len(PARAMETERS) else None


def index_of(name: str) -> int | None:
    """Place of this name in the table, None where it has no such name."""
    return INDEX.get(name)
