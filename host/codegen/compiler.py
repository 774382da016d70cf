"""The C compiler: which one, its flags, one run of it, and what happens where it fails.

The flags keep IEEE arithmetic as written (no contraction, never -ffast-math), so that compiled code and
CasADi's virtual machine agree bit for bit. Everything also works without a compiler: `compiled` is the one
place that decides so. `trimtab.host.codegen.libraries` caches and loads the results.
"""

from __future__ import annotations

import importlib.util
import os
import platform
import shutil
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import TypeVar

from trimtab.host.base import output
from trimtab.host.base.errors import TrimtabError

T = TypeVar("T")

FLAGS = ("-O2", "-ffp-contract=off", "-fno-math-errno", "-fPIC", "-shared")
ENGINES = ("auto", "vm", "c")
ENGINE_VARIABLE = "TRIMTAB_ENGINE"
_SECONDS = 300
_PROCESSOR_LINES = (
    "vendor_id", "cpu family", "model", "stepping", "flags", "features",
    "cpu implementer", "cpu architecture", "cpu variant", "cpu part",
)  # fmt: skip
"""Lines of /proc/cpuinfo from which a compiler knows the instructions of this machine."""
_VECTOR_INSTRUCTIONS = ("avx512f", "avx2", "avx", "sse2", "asimd")
"""By their names in /proc/cpuinfo."""
_warned: set[str] = set()


class CodegenError(TrimtabError):
    """A function cannot be compiled or run here; one line says why and what to do."""

    exit_code = 2


@dataclass(frozen=True, kw_only=True)
class Compiler:
    """A C compiler: the command that starts it, and a text that identifies the installation."""

    command: tuple[str, ...]
    identity: str

    @property
    def name(self) -> str:
        """Name of the compiler in messages."""
        return Path(self.command[0]).name if len(self.command) == 1 else "ziglang"


def engine_choice(engine: str | None = None) -> str:
    """Return "auto", "vm" or "c": the argument, else the environment's TRIMTAB_ENGINE, else "auto".

    Raises CodegenError for any other value.
    """
    choice = engine or os.environ.get(ENGINE_VARIABLE) or "auto"
    if choice not in ENGINES:
        where = "engine" if engine else ENGINE_VARIABLE
        raise CodegenError(f"{where} is {choice!r}, choose one of {', '.join(ENGINES)}")
    return choice


def find_compiler() -> Compiler | None:
    """Return the first of cc, gcc, clang on PATH, else the `ziglang` package's, else None."""
    for name in ("cc", "gcc", "clang"):
        path = shutil.which(name)
        if path is not None:
            return Compiler(command=(path,), identity=f"{name} {_stamp(Path(path))}")
    spec = importlib.util.find_spec("ziglang")
    if spec is not None and spec.origin is not None:
        command = (sys.executable, "-m", "ziglang", "cc")
        return Compiler(command=command, identity=f"ziglang {_stamp(Path(spec.origin))}")
    return None


def wanted_compiler(engine: str | None = None) -> Compiler | None:
    """Return the compiler to use, None for the virtual machine; see `engine_choice`.

    Raises CodegenError where C is requested and there is no compiler.
    """
    choice = engine_choice(engine)
    compiler = None if choice == "vm" else find_compiler()
    if choice == "c" and compiler is None:
        raise CodegenError("no C compiler: install cc, gcc, clang or the Python package ziglang")
    return compiler


def compiled(make: Callable[[Compiler], T], engine: str | None = None) -> T | None:
    """Return `make(compiler)`, or None where the caller must use its portable path.

    That is without a compiler, and where `make` raises CodegenError: then one line on stderr says so, once in
    a process. Raises CodegenError where C is requested (`engine_choice`) and not possible.
    """
    compiler = wanted_compiler(engine)
    if compiler is None:
        return None
    try:
        return make(compiler)
    except CodegenError as error:
        if engine_choice(engine) == "c":
            raise
        warn_once("compiler", f"{error}; continuing without compiled code, slower")
        return None


def warn_once(subject: str, line: str) -> None:
    """Print a warning on stderr, unless this process has printed one about this subject."""
    if subject not in _warned:
        _warned.add(subject)
        output.warn(line)


def flags(*, native: bool) -> tuple[str, ...]:
    """Return the compiler's flags; `native`: for all instructions of this machine, where they are known.

    Compiled code is cached. Without `processor` the cache could not tell this machine from another one.
    """
    if not native:
        return FLAGS
    if not processor():
        return (*FLAGS, "-O3")
    x86 = platform.machine().lower() in ("x86_64", "amd64", "i686")
    return (*FLAGS, "-O3", "-march=native" if x86 else "-mcpu=native")


@cache
def processor() -> str:
    """Return a text that identifies this machine's instructions, empty where the system does not say."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError:
        return ""
    known = {line for line in lines if line.split(":")[0].strip().lower() in _PROCESSOR_LINES}
    return "\n".join(sorted(known))


def vector_instructions() -> list[str]:
    """Return the instructions of this machine that decide the width of vectors, the widest first."""
    known = set(processor().lower().split())
    return [name for name in _VECTOR_INSTRUCTIONS if name in known]


def run_compiler(
    source: str, compiler: Compiler, folder: Path, *, native: bool = False, include: Path | None = None
) -> Path:
    """Return the shared library that the compiler makes of the source in this folder.

    `include`: directory of headers. The library is loaded once by another process, which an incomplete
    one would end. Raises CodegenError where the compiler or that fails, OSError where the source cannot be
    written.
    """
    text, library = folder / "function.c", folder / "function.so"
    text.write_text(source, encoding="utf-8")
    headers = () if include is None else (f"-I{include}",)
    command = [*compiler.command, *flags(native=native), *headers, "-o", str(library), str(text), "-lm"]
    failure = _failure(command)
    if failure is not None:
        raise CodegenError(f"the C compiler {compiler.name} failed: {failure}")
    failure = _failure([sys.executable, "-I", "-S", "-c", _LOAD, str(library)])
    if failure is not None:
        raise CodegenError(f"the C compiler {compiler.name} made no usable library: {failure}")
    return library


_LOAD = "import ctypes, sys; ctypes.CDLL(sys.argv[1])"


def _failure(command: list[str]) -> str | None:
    """Run a command and return why it failed in one line, None where it did not."""
    try:
        done = subprocess.run(
            command, capture_output=True, text=True, errors="replace", timeout=_SECONDS, check=False
        )
    except (OSError, subprocess.TimeoutExpired) as error:
        return f"it does not run: {error}"
    if done.returncode == 0:
        return None
    if done.returncode < 0:
        return f"it was ended by signal {-done.returncode}"
    lines = (done.stderr or done.stdout).strip().splitlines()
    return lines[-1 if command[0] == sys.executable else 0] if lines else f"exit code {done.returncode}"


def _stamp(path: Path) -> str:
    """Return real path, size and time of a file, which change with the installed version."""
    real = path.resolve()
    status = real.stat()
    return f"{real} {status.st_size} {status.st_mtime_ns}"
