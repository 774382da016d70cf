"""Parameter values on board, and the quantities that the control law derives from them.

Values are float32, as on the wire. A refused value leaves all values unchanged.
"""

from __future__ import annotations

from array import array
from collections.abc import Iterator, Mapping

from trimtab.firmware_model.law.limits import from_parameters
from trimtab.firmware_model.law.step import parameter_vector
from trimtab.firmware_model.storage.store import ReferenceStore
from trimtab.protocol.parameters import BY_NAME, INDEX, PARAMETERS, complete


class ParameterValues(Mapping[str, float]):
    """Values by name, in the order of the table.

    `vector` is the law's block `parameters`: values and allocation table. References are checked against
    `airframe` and `limits`. Raises ValueError if a name is unknown, a value is out of bounds, the rotors
    cannot produce every torque, or a lower limit is not below its upper limit.
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
        """Set a value, rounded to float32, and return it.

        Raises KeyError for an unknown name and ValueError for a refused value; nothing changes then.
        """
        rounded = BY_NAME[name].check(value)
        changed = {**self._values, name: rounded}
        try:
            vector = array("d", parameter_vector(changed))
            airframe, limits = from_parameters(changed)
        except ValueError as error:
            raise ValueError(f"{name}: {error}") from None
        self._values, self.vector = changed, vector
        self.airframe, self.limits = airframe, limits
        return rounded

    def us(self, name: str) -> int:
        """Return a parameter in seconds as whole microseconds."""
        return round(1e6 * self._values[name])


def stored_parameters(
    values: Mapping[str, float], store: ReferenceStore, vehicle_id: bytes
) -> ParameterValues:
    """Return `values`, overridden by those in the store. Values of another vehicle are discarded.

    `store.faults` reports discarded values. Raises ValueError if `values` themselves are refused.
    """
    settings = store.settings
    if settings.vehicle_id != vehicle_id:
        if settings.vehicle_id is not None:
            store.faults.append(f"parameters set for vehicle {settings.vehicle_id.hex()}: not used")
        settings.keep(vehicle_id, {})
    try:
        return ParameterValues({**values, **settings.values})
    except ValueError:
        store.faults.append("memory: parameters changed by the user do not fit")
    return ParameterValues(values)


def name_at(index: int) -> str | None:
    """Return the name of the parameter at this index of the table, or None."""
    return PARAMETERS[index].name if 0 <= index < len(PARAMETERS) else None


def index_of(name: str) -> int | None:
    """Return the index of this name in the table, or None."""
    return INDEX.get(name)
