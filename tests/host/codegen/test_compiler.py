"""Compiler and cache: found in order, keyed by content, written whole, and replaced where damaged."""

from __future__ import annotations

import os
import stat
from pathlib import Path

import pytest

from trimtab.host.codegen import compiler as module
from trimtab.host.codegen.compiler import (
    CodegenError,
    Compiler,
    cache_directory,
    engine_choice,
    find_compiler,
    library_path,
    shared_library,
)

FAKE = Compiler(command=("no-such-compiler",), identity="fake 1")


@pytest.fixture
def cache(tmp_path, monkeypatch):
    """An empty cache in place of the user's."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    return tmp_path / "cache"


def _program(folder: Path, name: str, script: str) -> Path:
    folder.mkdir(exist_ok=True)
    path = folder / name
    path.write_text(f"#!/bin/sh\n{script}\n")
    path.chmod(path.stat().st_mode | stat.S_IXUSR)
    return path


def test_find_compiler_takes_the_first_on_path(tmp_path, monkeypatch):
    clang = _program(tmp_path / "a", "clang", "exit 0")
    gcc = _program(tmp_path / "b", "gcc", "exit 0")
    monkeypatch.setenv("PATH", f"{tmp_path / 'a'}{os.pathsep}{tmp_path / 'b'}")
    found = find_compiler()
    assert found is not None
    assert found.command == (str(gcc),)
    assert found.name == "gcc"
    gcc.unlink()
    found = find_compiler()
    assert found is not None
    assert found.command == (str(clang),)


def test_find_compiler_without_any_is_none(tmp_path, monkeypatch):
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.setattr(module.importlib.util, "find_spec", lambda name: None)
    assert find_compiler() is None


def test_find_compiler_falls_back_on_ziglang(tmp_path, monkeypatch):
    monkeypatch.setenv("PATH", str(tmp_path))
    origin = tmp_path / "ziglang.py"
    origin.touch()
    spec = module.importlib.util.spec_from_file_location("ziglang", origin)
    monkeypatch.setattr(module.importlib.util, "find_spec", lambda name: spec)
    found = find_compiler()
    assert found is not None
    assert found.command[1:] == ("-m", "ziglang", "cc")
    assert found.name == "ziglang"


def test_compiler_that_was_replaced_has_another_identity(tmp_path, monkeypatch):
    monkeypatch.setenv("PATH", str(tmp_path / "a"))
    path = _program(tmp_path / "a", "cc", "exit 0")
    before = find_compiler()
    path.write_text("#!/bin/sh\nexit 1 # another version\n")
    after = find_compiler()
    assert before is not None
    assert after is not None
    assert before.identity != after.identity


@pytest.mark.parametrize("word", ["auto", "vm", "c"])
def test_engine_choice_reads_the_environment(word, monkeypatch):
    monkeypatch.setenv("TRIMTAB_ENGINE", word)
    assert engine_choice() == word
    assert engine_choice("vm") == "vm"


def test_engine_choice_of_another_word_raises_with_the_choices(monkeypatch):
    monkeypatch.setenv("TRIMTAB_ENGINE", "fast")
    with pytest.raises(CodegenError, match="TRIMTAB_ENGINE is 'fast', choose one of auto, vm, c") as caught:
        engine_choice()
    assert caught.value.exit_code == 2


def test_library_path_follows_source_and_compiler(cache):
    other = Compiler(command=FAKE.command, identity="fake 2")
    paths = {library_path("a", FAKE), library_path("b", FAKE), library_path("a", other)}
    assert len(paths) == 3
    assert library_path("a", FAKE) in paths
    assert all(path.parent == cache / "trimtab" / "codegen" for path in paths)


def test_shared_library_is_compiled_once_and_leaves_nothing_else(cache, tmp_path):
    count = tmp_path / "count"
    script = f"""echo x >> {count}
while [ $# -gt 0 ]; do if [ "$1" = -o ]; then echo library > "$2"; fi; shift; done"""
    compiler = Compiler(command=(str(_program(tmp_path / "bin", "cc", script)),), identity="script")
    first, second = shared_library("int x;", compiler), shared_library("int x;", compiler)
    assert first == second
    assert first.read_text() == "library\n"
    assert count.read_text() == "x\n"
    assert list(cache_directory().iterdir()) == [first]


def test_shared_library_of_a_failing_compiler_raises_with_its_first_line(cache, tmp_path):
    program = _program(tmp_path / "bin", "cc", "echo 'math.h: not found' >&2; exit 1")
    with pytest.raises(CodegenError, match=r"C compiler cc failed: math\.h: not found"):
        shared_library("int x;", Compiler(command=(str(program),), identity="script"))
    assert list(cache_directory().iterdir()) == []


def test_shared_library_of_a_missing_program_raises(cache):
    with pytest.raises(CodegenError, match="does not run"):
        shared_library("int x;", FAKE)


def test_cache_directory_that_cannot_be_made_is_a_temporary_one(tmp_path, monkeypatch):
    blocked = tmp_path / "file"
    blocked.touch()
    monkeypatch.setenv("XDG_CACHE_HOME", str(blocked))
    assert cache_directory().is_dir()
    assert cache_directory() == cache_directory()


def test_flags_keep_ieee_arithmetic():
    assert "-ffp-contract=off" in module.FLAGS
    assert not any("fast" in flag for flag in module.FLAGS)
