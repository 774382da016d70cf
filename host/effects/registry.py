"""Registry of candidate effects: the shipped ones and those in the `effects/` folder of a workspace."""

from __future__ import annotations

import dataclasses
import hashlib
from collections.abc import Mapping
from pathlib import Path
from types import ModuleType

from trimtab.host.base.errors import TrimtabError
from trimtab.host.base.trust import read_code
from trimtab.host.effects import flat_imports, trial
from trimtab.host.effects.effect import Effect

_NOT_EFFECTS = {
    "__init__",
    "effect",
    "registry",
    "feedforward",
    "flat_imports",
    "parameter",
    "trial",
    "unknowns",
}


class EffectError(TrimtabError, ValueError):
    """Error for an effect file that cannot be used, or for the name of an unknown effect."""

    exit_code = 2


def load_effects(workspace: Path | str | None = None, *, trusted: bool = False) -> dict[str, Effect]:
    """Return all effects by name: the shipped ones, then those of the workspace, each sorted by name.

    A file defines one effect as `EFFECT`. Its name is that of the file, with hyphens instead of underscores.

    Parameters
    ----------
    workspace
        Folder that may hold a folder `effects`; None for the shipped effects only.
    trusted
        Whether its code may run although others can change it.

    Raises
    ------
    UntrustedError
        If others can change a file of the workspace and it is not trusted.
    EffectError
        If a file does not define its effect, a slot returns wrong numbers, a workspace file takes a shipped
        name, or an effect refers to an unknown effect.
    """
    shipped = ((path, path.read_bytes()) for path in _files(Path(__file__).parent))
    effects = {effect.name: effect for effect in (_read_effect(*file) for file in shipped)}
    folder = None if workspace is None else Path(workspace) / "effects"
    if folder is not None and folder.is_dir():
        for path in _files(folder):
            effect = _read_effect(path, read_code(path, trusted=trusted))
            if effect.name in effects:
                raise EffectError(
                    f"effects/{_stem(effect.name)}.py: {effect.name} is a shipped effect; rename it"
                )
            effects[effect.name] = effect
    for effect in effects.values():
        for other in effect.requires_any:
            if other not in effects:
                raise EffectError(f"effect {effect.name} requires {other}, which is not defined")
        _check_references(effect, effects)
    return effects


def _check_references(effect: Effect, effects: Mapping[str, Effect]) -> None:
    """Raise EffectError if exact_aliases or observed_relative_to refer to an unknown or unsuitable effect."""
    for alias in effect.exact_aliases:
        other = effects.get(alias.effect)
        if other is None:
            raise EffectError(f"effect {effect.name}: exact_aliases {alias.effect}, which is not defined")
        if alias.ratio is not None and other.neutral[0] == 0.0:
            raise EffectError(
                f"effect {effect.name}: exact_aliases {alias.effect} has a ratio, but {other.keys[0]} of "
                f"{other.name} is 0 at neutral"
            )
    over = effect.observed_relative_to
    if over is not None and over not in effects:
        raise EffectError(f"effect {effect.name}: observed_relative_to {over}, which is not defined")


def _stem(name: str) -> str:
    return name.replace("-", "_")


def _files(folder: Path) -> list[Path]:
    return sorted(path for path in folder.glob("*.py") if path.stem not in _NOT_EFFECTS)


def _read_effect(path: Path, source: bytes) -> Effect:
    """Return the effect that a file defines whose content is `source`."""
    label = f"effects/{path.name}"
    digest = hashlib.sha256(source.replace(b"\r\n", b"\n")).hexdigest()[:12]
    module = ModuleType(f"trimtab_effect_{path.stem}_{digest}")
    module.__file__ = str(path)
    try:
        with flat_imports.accepted(label, source):
            # The importing system would read the file again, or bytecode beside it.
            exec(compile(source, str(path), "exec"), vars(module))
    except Exception as error:  # any exception of a user's file is an error of that file
        raise EffectError(f"{label}: {type(error).__name__}: {error}") from error
    effect = getattr(module, "EFFECT", None)
    if not isinstance(effect, Effect):
        raise EffectError(f"{label}: does not define EFFECT = Effect(...)")
    if _stem(effect.name) != path.stem:
        raise EffectError(
            f"{label}: defines effect {effect.name}; rename the file to {_stem(effect.name)}.py"
        )
    wrong = trial.fault(effect)
    if wrong is not None:
        raise EffectError(f"{label}: {wrong}")
    return dataclasses.replace(effect, source_id=digest)
