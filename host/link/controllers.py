"""From a controller's settings to what a flight request takes: a stream from the host, or parameters."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path

from trimtab.host.base.artefacts import content_id
from trimtab.host.base.errors import UsageError
from trimtab.host.control.mpc import Mpc
from trimtab.host.control.settings import ControllerSettings, DfbcSettings, MpcSettings
from trimtab.host.effects import Effect
from trimtab.host.link.host_control import FlownBy, HostControl
from trimtab.host.models.model import Model
from trimtab.host.vehicle import Vehicle, to_parameters


def flown_by(
    name: str | Path,
    settings: ControllerSettings,
    vehicle: Vehicle,
    *,
    feedforward: bool,
    model: Model | None = None,
    effects: Mapping[str, Effect] | None = None,
) -> FlownBy:
    """Return what the settings of controller `name` mean for a flight.

    feedforward: whether the flight has a feed-forward. model: of the residual, with its library of effects.
    Raises UsageError for a model or feed-forward that the controller lacks or does not use.
    """
    label = Path(name).stem
    uses_model = isinstance(settings, MpcSettings) and settings.residual == "model"
    uses_feedforward = isinstance(settings, DfbcSettings) and settings.feedforward
    for what, option, given, used in (
        ("model", "--model MODEL", model is not None, uses_model),
        ("feed-forward", "--feedforward FILE", feedforward, uses_feedforward),
    ):
        if used and not given:
            raise UsageError(f"the controller {label} needs a {what}; give {option}")
        if given and not used:
            raise UsageError(f"the controller {label} uses no {what}; leave out {option.split()[0]}")
    if isinstance(settings, DfbcSettings):
        nominal = to_parameters(vehicle)
        changed = {k: v for k, v in settings.parameters(vehicle).items() if v != nominal[k]}
        return FlownBy(parameters=changed)
    return FlownBy(
        control=HostControl(
            controller=Mpc(settings, vehicle, model=model, effects=effects),
            name=label,
            settings_id=settings_id(settings),
            model_id=None if model is None else model.id,
            computing_us=settings.computing_time_us,
        )
    )


def settings_id(settings: ControllerSettings) -> str:
    """Return the first 12 hex digits of the SHA-256 of settings, without what they were tuned on."""
    content = settings.model_dump(mode="json", exclude={"tuned"})
    return content_id(json.dumps(content, sort_keys=True, separators=(",", ":")).encode())
