"""Check arrays against the shapes in their annotations: `Annotated[np.ndarray, "segments steps 12"]`.

A shape lists axes. A number is a length. A name stands for one length within a call or an object. `_` is any
length, and `...` at the start stands for any leading axes. Only arrays are checked: not None, not symbols.
The arrays of a tuple of fixed length are checked too; those of lists and dictionaries are not.

Run as a program, this checks a verb of Trimtab: `python tests/shapes.py trace a.mcap`. It prints the first
array of a wrong shape and returns 70, or prints how many arrays it checked.
"""

from __future__ import annotations

import dataclasses
import functools
import importlib.abc
import importlib.machinery
import inspect
import sys
from collections.abc import Callable, Mapping, Sequence
from types import ModuleType, UnionType
from typing import Annotated, Any, Union, get_args, get_origin

import numpy as np

PACKAGE = "trimtab.host."
checked = 0


class ShapeError(BaseException):
    """An array is not of the shape that its annotation states. No verb catches it as a bug of its own."""


def shape_of(hint: Any) -> str | None:
    """Return the shape of `Annotated[np.ndarray, shape]`, also where other types are allowed beside it.

    `NDArray[..]` may stand for `np.ndarray`.
    """
    if get_origin(hint) is Annotated:
        of = get_origin(hint.__origin__) or hint.__origin__
        return hint.__metadata__[0] if of is np.ndarray else None
    if get_origin(hint) in (Union, UnionType):
        return next((shape for shape in map(shape_of, get_args(hint)) if shape is not None), None)
    return None


def shapes_of(hint: Any) -> str | tuple[Any, ...] | None:
    """Return `shape_of`, for a tuple the same of each entry; None where there is no shape."""
    shape = shape_of(hint)
    if shape is not None:
        return shape
    if get_origin(hint) in (Union, UnionType):
        return next((shapes for shapes in map(shapes_of, get_args(hint)) if shapes is not None), None)
    if get_origin(hint) is not tuple or ... in get_args(hint):
        return None
    shapes = tuple(map(shapes_of, get_args(hint)))
    return shapes if any(each is not None for each in shapes) else None


def check_all(value: Any, shapes: str | tuple[Any, ...] | None, lengths: dict[str, int], where: str) -> None:
    """Compare an array, or the arrays of a tuple, as `check` does."""
    if isinstance(shapes, str):
        check(value, shapes, lengths, where)
    elif isinstance(shapes, tuple) and isinstance(value, tuple):
        for k, (entry, each) in enumerate(zip(value, shapes, strict=True)):
            check_all(entry, each, lengths, f"{where}[{k}]")


def check(value: Any, shape: str, lengths: dict[str, int], where: str) -> None:
    """Compare an array with its shape; `lengths` gains the names that are new. Raises ShapeError."""
    global checked
    if not isinstance(value, np.ndarray):
        return
    checked += 1
    axes, actual = shape.split(), value.shape
    if axes[:1] == ["..."]:
        axes = axes[1:]
        actual = actual[max(0, value.ndim - len(axes)) :]
    fits = len(axes) == len(actual)
    for axis, size in zip(axes, actual, strict=False):
        if axis != "_":
            fits = fits and size == (int(axis) if axis.isdigit() else lengths.setdefault(axis, size))
    if not fits:
        raise ShapeError(f"{where} has shape {value.shape}, not ({shape}) with {lengths}")


def shapes_in(annotations: Mapping[str, Any], module: ModuleType) -> dict[str, str | tuple[Any, ...]]:
    """Return the shapes of each annotated array or tuple of arrays, by name."""
    hints = {
        name: eval(hint, vars(module)) if isinstance(hint, str) else hint
        for name, hint in annotations.items()
        if "Annotated" in str(hint)
    }
    return {name: shapes for name, hint in hints.items() if (shapes := shapes_of(hint)) is not None}


def checked_function(function: Callable[..., Any], module: ModuleType) -> Callable[..., Any]:
    """Return the function with a check of its arguments and its result, or itself where it has no shapes."""
    shapes = shapes_in(getattr(function, "__annotations__", {}), module)
    if not shapes:
        return function
    signature = inspect.signature(function)

    @functools.wraps(function)
    def call(*args: Any, **kwargs: Any) -> Any:
        lengths: dict[str, int] = {}
        for name, value in signature.bind(*args, **kwargs).arguments.items():
            if name in shapes:
                check_all(value, shapes[name], lengths, f"{function.__qualname__}: {name}")
        result = function(*args, **kwargs)
        if "return" in shapes:
            check_all(result, shapes["return"], lengths, f"{function.__qualname__}: result")
        return result

    return call


def check_class(cls: type, module: ModuleType) -> None:
    """Check the fields of a dataclass when it is built, and the methods of any class."""
    for name, member in list(vars(cls).items()):
        if inspect.isfunction(member):
            setattr(cls, name, checked_function(member, module))
        elif isinstance(member, classmethod | staticmethod):
            setattr(cls, name, type(member)(checked_function(member.__func__, module)))
        elif isinstance(member, property) and member.fget is not None:
            setattr(cls, name, property(checked_function(member.fget, module)))
    shapes = shapes_in(vars(cls).get("__annotations__", {}), module)
    if not dataclasses.is_dataclass(cls) or not shapes:
        return
    build = cls.__init__

    @functools.wraps(build)
    def init(self: Any, *args: Any, **kwargs: Any) -> None:
        build(self, *args, **kwargs)
        lengths: dict[str, int] = {}
        for name, shape in shapes.items():
            check_all(getattr(self, name), shape, lengths, f"{cls.__name__}.{name}")

    setattr(cls, "__init__", init)  # noqa: B010


class Loader(importlib.machinery.SourceFileLoader):
    """Loads a module and puts the checks into it."""

    def exec_module(self, module: ModuleType) -> None:
        super().exec_module(module)
        for name, member in list(vars(module).items()):
            if getattr(member, "__module__", None) != module.__name__:
                continue
            if inspect.isfunction(member):
                setattr(module, name, checked_function(member, module))
            elif inspect.isclass(member):
                check_class(member, module)


class Finder(importlib.abc.MetaPathFinder):
    """Finds the modules of the host and loads them with checks."""

    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> importlib.machinery.ModuleSpec | None:
        if not fullname.startswith(PACKAGE):
            return None
        spec = importlib.machinery.PathFinder.find_spec(fullname, path)
        if spec is not None and isinstance(spec.loader, importlib.machinery.SourceFileLoader):
            spec.loader = Loader(spec.loader.name, spec.loader.path)
        return spec


def main(words: list[str]) -> int:
    """Run a verb with every array checked."""
    sys.meta_path.insert(0, Finder())
    from trimtab.host import cli

    try:
        code = cli.main(words)
    except ShapeError as error:
        print(error, file=sys.stderr)
        return 70
    print(f"{checked} arrays checked", file=sys.stderr)
    return code


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
