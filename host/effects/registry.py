"""Finds the candidate effects: the shipped ones and those of a workspace's `effects/` folder."""

from __future__ import annotations

import dataclasses
import hashlib
import importlib.util
from collections.abc import Mapping
from pathlib import Path

from trimtab.host.base.errors import TrimtabError
from trimtab.host.effects import flat_imports
from trimtab.host.effects.effect import Effect

_NOT_EFFECTS = {"__init__", "effect", "registry", "feedforward", "flat_imports", "parameter", "unknowns"}


class EffectError(TrimtabError, ValueError):
    """An effect file that cannot be used, or an effect name nobody defines."""

    exit_code = 2


def load_effects(workspace: Path | str | None = None) -> dict[str, Effect]:
    """Every effect by name: the shipped ones sorted by name, then the workspace's.

    A file defines one effect, as `EFFECT`, named like the file with hyphens for underscores. Raises
    EffectError naming the file where that does not hold, or where a workspace file takes a shipped name.
    """
    effects = {effect.name: effect for effect in _read_folder(Path(__file__).parent)}
    folder = None if workspace is None else Path(workspace) / "effects"
    if folder is not None and folder.is_dir():
        for effect in _read_folder(folder):
            if effect.name in effects:
                raise EffectError(
                    f"effects/{_stem(effect.name)}.py: {effect.name} is a shipped effect; rename it"
                )
            effects[effect.name] = effect
    for effect in effects.values():
        for other in effect.requires_any:
            if other not in effects:
                raise EffectError(f"effect {effect.name} requires {other}, which nobody defines")
        _check_references(effect, effects)
    return effects


def _check_references(effect: Effect, effects: Mapping[str, Effect]) -> None:
    """Raise EffectError where an effect is exactly like, or shows relative to, what is not there for it."""
    for alias in effect.exact_aliases:
        other = effects.get(alias.effect)
        if other is None:
            raise EffectError(f"effect {effect.name}: exact_aliases {alias.effect}, which nobody defines")
        if alias.ratio is not None and other.neutral[0] == 0.0:
            raise EffectError(
                f"effect {effect.name}: exact_aliases {alias.effect} has a ratio, but {other.keys[0]} of "
                f"{other.name} is 0 at neutral"
            )
    over = effect.observed_relative_to
    if over is not None and over not in effects:
        raise EffectError(f"effect {effect.name}: observed_relative_to {over}, which nobody defines")


def _stem(name: str) -> str:
    return name.replace("-", "_")


def _read_folder(folder: Path) -> list[Effect]:
    files = sorted(path for path in folder.glob("*.py") if path.stem not in _NOT_EFFECTS)
    return [_read_file(path) for path in files]


def _read_file(path: Path) -> Effect:
    label = f"effects/{path.name}"
    source = path.read_bytes()
    digest = hashlib.sha256(source.replace(b"\r\n", b"\n")).hexdigest()[:12]
    spec = importlib.util.spec_from_file_location(f"trimtab_effect_{path.stem}_{digest}", path)
    if spec is None or spec.loader is None:
        raise EffectError(f"{label}: not a Python file")
    module = importlib.util.module_from_spec(spec)
    try:
        with flat_imports.accepted(label, source):
            spec.loader.exec_module(module)
    except Exception as error:  # whatever a user's file raises is that file's error
        raise EffectError(f"{label}: {type(error).__name__}: {error}") from error
    effect = getattr(module, "EFFECT", None)
    if not isinstance(effect, Effect):
        raise EffectError(f"{label}: defines no EFFECT = Effect(...)")
    if _stem(effect.name) != path.stem:
        raise EffectError(
            f"{label}: its effect is named {effect.name}; the file must be {_stem(effect.name)}.py"
        )
    return dataclasses.replace(effect, source_id=digest)
