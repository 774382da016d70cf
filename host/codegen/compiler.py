"""C source to a shared library: the compiler, its flags, and the cache of the results.

The flags keep IEEE arithmetic as written (no contraction, never -ffast-math), so that compiled code and
CasADi's virtual machine agree bit for bit. Libraries are in the user's cache, named by the hash of everything
that determines them, written under a temporary name and renamed. Everything also works without a compiler.
"""

from __future__ import annotations

import atexit
import hashlib
import importlib.util
import os
import platform
import shutil
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from trimtab.host.base.errors import TrimtabError

FLAGS = ("-O2", "-ffp-contract=off", "-fno-math-errno", "-fPIC", "-shared")
ENGINES = ("auto", "vm", "c")
ENGINE_VARIABLE = "TRIMTAB_ENGINE"
_SECONDS = 300


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


def shared_library(
    source: str, compiler: Compiler, *, native: bool = False, include: Path | None = None
) -> Path:
    """Return the path of the shared library for this C source, compiled now unless the cache has it.

    `native`: for the instructions of this machine. `include`: directory of its headers; the source must name
    their version. Raises CodegenError where the compiler fails.
    """
    path = library_path(source, compiler, native=native)
    if not path.exists():
        headers = () if include is None else (f"-I{include}",)
        _compile(source, compiler, path, (*flags(native=native), *headers))
    return path


def flags(*, native: bool) -> tuple[str, ...]:
    """Return the compiler's flags; `native`: for all instructions of this machine."""
    if not native:
        return FLAGS
    x86 = platform.machine().lower() in ("x86_64", "amd64", "i686")
    return (*FLAGS, "-O3", "-march=native" if x86 else "-mcpu=native")


@cache
def _processor() -> str:
    """Return a text that identifies this machine's instructions."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError:
        return platform.processor()
    features = [line for line in lines if line.lower().startswith(("flags", "features"))]
    return features[0] if features else platform.processor()


def library_path(source: str, compiler: Compiler, *, native: bool = False) -> Path:
    """Return the path in the cache of the library for this source, compiler, flags and machine."""
    parts = (source, compiler.identity, " ".join(flags(native=native)), sys.platform, platform.machine())
    parts += (_processor(),) if native else ()
    digest = hashlib.sha256("\0".join(parts).encode()).hexdigest()[:32]
    return cache_directory() / f"{digest}.so"


@cache
def _temporary() -> Path:
    """Return a directory that is deleted when this process ends, for machines without a cache."""
    path = Path(tempfile.mkdtemp(prefix="trimtab-"))
    atexit.register(shutil.rmtree, path, ignore_errors=True)
    return path


def cache_directory() -> Path:
    """Return the directory of compiled libraries: XDG_CACHE_HOME or ~/.cache, then trimtab/codegen."""
    base = os.environ.get("XDG_CACHE_HOME", "")
    try:
        root = Path(base) if os.path.isabs(base) else Path.home() / ".cache"
        path = root / "trimtab" / "codegen"
        path.mkdir(parents=True, exist_ok=True)
    except (OSError, RuntimeError):
        return _temporary()
    return path if os.access(path, os.W_OK | os.X_OK) else _temporary()


def _stamp(path: Path) -> str:
    """Return real path, size and time of a file, which change with the installed version."""
    real = path.resolve()
    status = real.stat()
    return f"{real} {status.st_size} {status.st_mtime_ns}"


def _compile(source: str, compiler: Compiler, path: Path, flags: tuple[str, ...]) -> None:
    """Compile the source to a library at `path`, which appears whole or not at all. Raises CodegenError."""
    with tempfile.TemporaryDirectory(prefix=".build-", dir=path.parent) as folder:
        text, library = Path(folder) / "function.c", Path(folder) / "function.so"
        text.write_text(source, encoding="utf-8")
        command = [*compiler.command, *flags, "-o", str(library), str(text), "-lm"]
        try:
            done = subprocess.run(
                command, capture_output=True, text=True, errors="replace", timeout=_SECONDS, check=False
            )
        except (OSError, subprocess.TimeoutExpired) as error:
            raise CodegenError(f"the C compiler {compiler.name} does not run: {error}") from None
        if done.returncode != 0 or not library.exists():
            lines = (done.stderr or done.stdout).strip().splitlines()
            detail = lines[0] if lines else f"exit code {done.returncode}"
            raise CodegenError(f"the C compiler {compiler.name} failed: {detail}")
        os.replace(library, path)
