"""Shared test settings: derandomised property tests, and skips that say why.

`require("compiler")` skips a test where this machine lacks a part; TRIMTAB_REQUIRE=compiler,generator makes
such skips failures. A skip without a reason always fails.
"""

from __future__ import annotations

import importlib.util
import os
import shutil
import signal
from collections.abc import Callable, Generator, Iterator
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from typing import Any

import pytest
from hypothesis import settings

settings.register_profile("trimtab", derandomize=True, deadline=None, database=None)
settings.load_profile("trimtab")

# One cache of compiled engines and no colour, whatever the machine's own settings are.
os.environ["NO_COLOR"] = "1"
# Tests also call what public functions do in one thread; numpy reads it when it is imported.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")


def _compiler() -> str | None:
    if any(shutil.which(name) for name in ("cc", "gcc", "clang")) or importlib.util.find_spec("ziglang"):
        return None
    return "no C compiler (cc, gcc, clang or the compiler extra)"


def _module(name: str, extra: str) -> Callable[[], str | None]:
    return lambda: None if importlib.util.find_spec(name) else f"{name} is not installed ({extra})"


def _program(*names: str) -> Callable[[], str | None]:
    return lambda: None if any(map(shutil.which, names)) else f"no {' or '.join(names)} on PATH"


def _clients() -> str | None:
    missing = [name for name in ("mavsdk", "MAVProxy") if not importlib.util.find_spec(name)]
    return f"{' and '.join(missing)} not installed (requirements-clients.lock)" if missing else None


def _node() -> str | None:
    missing = [name for name in ("node", "npm") if shutil.which(name) is None]
    return f"{' and '.join(missing)} not on PATH" if missing else None


def _plants() -> str | None:
    missing = [name for name in ("rotorpy", "crazyflow") if not importlib.util.find_spec(name)]
    return f"{' and '.join(missing)} not installed (requirements-plants.lock)" if missing else None


def _pty() -> str | None:
    return None if hasattr(os, "openpty") else "no pseudo-terminals here"


RECORDED_FLIGHTS = Path(__file__).parent.parent.parent / "shared" / "data"
"""Real flights that other people measured; too large, and not ours, to be kept here."""


def _recorded_flights() -> str | None:
    return None if RECORDED_FLIGHTS.is_dir() else "no recorded flights in ../shared/data beside this checkout"


def _arm() -> str | None:
    missing = [name for name in ("aarch64-linux-gnu-gcc", "qemu-aarch64") if shutil.which(name) is None]
    return f"{' and '.join(missing)} not on PATH (gcc-aarch64-linux-gnu, qemu-user)" if missing else None


PARTS: dict[str, Callable[[], str | None]] = {
    "arm": _arm,
    "browser": _program("chromium", "chromium-browser", "google-chrome"),
    "clients": _clients,
    "compiler": _compiler,
    "diffrax": _module("diffrax", "requirements-bench.lock"),
    "flights": _recorded_flights,
    "generator": _module("grpc_tools", "requirements-all.lock"),
    "git": _program("git"),
    "minsnap": _module("minsnap_trajectories", "requirements-bench.lock"),
    "node": _node,
    "plants": _plants,
    "pty": _pty,
    "rockit": _module("rockit", "requirements-bench.lock"),
    "uv": _program("uv"),
    "watch": _module("foxglove", "requirements-all.lock"),
}
"""Parts that a machine may lack: name to a check that returns what is missing, or None."""


def required_parts() -> frozenset[str]:
    """The parts that TRIMTAB_REQUIRE names. Raises pytest.UsageError on an unknown one."""
    words = os.environ.get("TRIMTAB_REQUIRE", "").split(",")
    named = frozenset(part.strip() for part in words if part.strip())
    unknown = sorted(named - PARTS.keys())
    if unknown:
        raise pytest.UsageError(f"TRIMTAB_REQUIRE: unknown {', '.join(unknown)}; known: {', '.join(PARTS)}")
    return named


def pytest_configure(config: pytest.Config) -> None:
    """Refuse a misspelt TRIMTAB_REQUIRE before any test runs, and restore SIGINT, which tests send.

    A shell ignores SIGINT in what it starts in the background, and every process that a test starts inherits
    that.
    """
    required_parts()
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.hookimpl(trylast=True)
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Put long tests first, and keep tests on one worker that belong together.

    These are tests in real time, of one xdist_group, or with a common fixture of their module. Two workers
    would set such a fixture up twice, and two flights in real time would share the cores. xdist groups by the
    end of a test's id; what xdist 3.8 writes there is lost from pytest 9.2 on.
    """
    items.sort(key=lambda item: item.get_closest_marker("long") is None)
    if not getattr(config.option, "loadgroup", False):  # set in workers where groups are asked for
        return
    for item in items:
        group = _group(item)
        if group is not None and not item.nodeid.endswith(f"@{group}"):
            private: Any = item
            private._id = private.id.parse(f"{item.nodeid}@{group}")


def _group(item: Any) -> str | None:
    """The group that the test's marks name; its module where it uses a fixture of the module; or None."""
    if item.get_closest_marker("realtime") is not None:
        return "realtime"
    mark = item.get_closest_marker("xdist_group")
    if mark is not None:
        return mark.args[0]
    fixtures = (definitions[-1] for definitions in item._fixtureinfo.name2fixturedefs.values())
    return item.module.__name__ if any(fixture.scope == "module" for fixture in fixtures) else None


@pytest.fixture(scope="session")
def require() -> Callable[[str], None]:
    """A function that skips the test where a part is missing; its reason starts with the part's name."""

    def check(part: str) -> None:
        missing = PARTS[part]()
        if missing:
            pytest.skip(f"{part}: {missing}")

    return check


@pytest.fixture
def virtual_machine(monkeypatch: pytest.MonkeyPatch) -> None:
    """Evaluate models in CasADi's virtual machine, in this process and those it starts.

    For tests whose subject is not the compiled engine: the result is the same and nothing is compiled.
    """
    monkeypatch.setenv("TRIMTAB_ENGINE", "vm")


@pytest.fixture
def full_disk() -> Callable[[int], AbstractContextManager[None]]:
    """Inside the context it gives, no file of this process grows beyond that many bytes."""

    @contextmanager
    def limit(size: int) -> Iterator[None]:
        resource = pytest.importorskip("resource", reason="no limits of file size here")
        before = resource.getrlimit(resource.RLIMIT_FSIZE)
        resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
        try:
            yield
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, before)

    return limit


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(
    item: pytest.Item, call: pytest.CallInfo[None]
) -> Generator[None, pytest.TestReport, pytest.TestReport]:
    """Turn a skip of a required part, or one without a reason, into a failure."""
    report = yield
    if report.skipped and not hasattr(report, "wasxfail"):
        reason = _reason(report.longrepr)
        part = reason.partition(":")[0]
        if part in required_parts():
            report.outcome = "failed"
            report.longrepr = f"skipped, but TRIMTAB_REQUIRE names this part: {reason}"
        elif not reason or reason == "unconditional skip":
            report.outcome = "failed"
            report.longrepr = "a skip must say why"
    return report


def _reason(longrepr: Any) -> str:
    """The reason of a skip report, or an empty text."""
    text = longrepr[2] if isinstance(longrepr, tuple) else str(longrepr)
    return text.removeprefix("Skipped").removeprefix(":").strip()
