"""Everything is imported as trimtab.*: one copy of each module, and a user's own host.py stays theirs."""

from __future__ import annotations

import subprocess
import sys
import warnings
from pathlib import Path

import pytest

import trimtab
from trimtab.host.effects import Effect, load_effects

SHIPPED_EFFECT = Path(__file__).parents[1] / "host" / "effects" / "linear_drag.py"
FLAT = ("host", "protocol", "firmware_model", "sitl")


def run_python(code: str, folder: Path) -> str:
    """Return what a script with this code prints; its folder comes first on the path."""
    script = folder / "script.py"
    script.write_text(code, encoding="utf-8")
    done = subprocess.run(
        [sys.executable, str(script)], capture_output=True, text=True, cwd=folder, check=False
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_public_names_resolve() -> None:
    assert set(dir(trimtab)) == set(trimtab.__all__)
    for name in trimtab.__all__:
        assert callable(getattr(trimtab, name)), name


def test_unknown_public_name_raises_attribute_error() -> None:
    with pytest.raises(AttributeError, match="no_such_name"):
        _ = trimtab.no_such_name


def test_import_of_trimtab_loads_nothing_heavy(tmp_path: Path) -> None:
    code = (
        "import sys, trimtab\nprint([m for m in sys.modules if m in ('numpy', 'casadi', 'trimtab.host')])\n"
    )
    assert run_python(code, tmp_path) == "[]\n"


def test_script_with_own_host_and_protocol_keeps_them(tmp_path: Path) -> None:
    for name in FLAT:
        (tmp_path / f"{name}.py").write_text(f"MINE = '{name}'\n", encoding="utf-8")
    code = (
        "import host, protocol, firmware_model, sitl\n"
        "from trimtab import fly, import_log, learn, load_effects, plan, read_flight, trace\n"
        "import trimtab.sitl.vehicle\n"
        "load_effects()\n"
        "print(host.MINE, protocol.MINE, firmware_model.MINE, sitl.MINE)\n"
    )
    assert run_python(code, tmp_path) == "host protocol firmware_model sitl\n"


def test_every_module_is_loaded_once(tmp_path: Path) -> None:
    code = (
        "import os, sys\n"
        "import trimtab.host.trace.run, trimtab.host.plan, trimtab.sitl.studies.blind\n"
        "modules = [m for m in sys.modules.values() if getattr(m, '__file__', None)]\n"
        "files = [os.path.realpath(m.__file__) for m in modules]\n"
        "ours = [f for f in files if '/host/' in f or '/sitl/' in f or '/protocol/' in f]\n"
        "print(len(ours) - len(set(ours)), len(ours) > 100)\n"
        f"print([m for m in sys.modules if m.split('.')[0] in {FLAT}])\n"
    )
    assert run_python(code, tmp_path) == "0 True\n[]\n"


def workspace_with_effect(folder: Path, source: str) -> Path:
    """Return a workspace with one effect of the user's own."""
    (folder / "effects").mkdir()
    (folder / "effects" / "my_drag.py").write_text(source, encoding="utf-8")
    return folder


def test_effect_file_with_flat_imports_is_loaded_with_a_warning(tmp_path: Path) -> None:
    source = SHIPPED_EFFECT.read_text(encoding="utf-8").replace('"linear-drag"', '"my-drag"')
    space = workspace_with_effect(tmp_path, source.replace("trimtab.host", "host"))
    before = set(sys.modules)
    with pytest.warns(FutureWarning, match=r"effects/my_drag\.py: imports .*write trimtab\.host\.effects"):
        effects = load_effects(space)
    assert isinstance(effects["my-drag"], Effect)
    assert not [name for name in set(sys.modules) - before if name.split(".")[0] in FLAT]


def test_effect_file_with_full_imports_is_loaded_without_a_warning(tmp_path: Path) -> None:
    source = SHIPPED_EFFECT.read_text(encoding="utf-8").replace('"linear-drag"', '"my-drag"')
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert "my-drag" in load_effects(workspace_with_effect(tmp_path, source))
