"""What a blind study draws lies well within the bounds of the library.

An estimate at a bound counts as the work of another cause, so a bound must not be where a true size may be.
"""

from __future__ import annotations

import pytest

from trimtab.host.effects import load_effects
from trimtab.sitl.kinds import KINDS
from trimtab.sitl.studies.worlds import SIZE

EFFECTS = load_effects()


@pytest.mark.parametrize("name", sorted(set(EFFECTS) & set(KINDS)))
def test_greatest_drawn_size_is_a_fifth_from_the_bound(name: str) -> None:
    parameters = {parameter.key: parameter for parameter in EFFECTS[name].parameters}
    for quantity in KINDS[name].quantities:
        parameter = parameters.get(quantity.key)
        if parameter is None or not parameter.strength or quantity.drawn is not None:
            continue
        greatest = min(quantity.neutral + SIZE[1] * quantity.typical, quantity.upper)
        room = parameter.upper - parameter.neutral
        assert greatest - parameter.neutral <= room / 1.2, parameter.key
