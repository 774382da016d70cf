"""Compiled libraries: keyed by content, written whole, and compiled anew where the cache does not serve."""

from __future__ import annotations

import ctypes
import errno
import os
import shutil
import stat
import subprocess
import sys
from pathlib import Path

import pytest

from trimtab.host.codegen import compiler as compiler_module
from trimtab.host.codegen import libraries as module
from trimtab.host.codegen.compiler import CodegenError, Compiler, find_compiler
from trimtab.host.codegen.libraries import cache_directory, library_key, load_library

SOURCE = "int three(void) { return 3; }"
FAKE = Compiler(command=("no-such-compiler",), identity="fake 1")


@pytest.fixture(autouse=True)
def cache(tmp_path, monkeypatch):
    """An empty cache in place of the user's."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setattr(compiler_module, "_warned", set())
    monkeypatch.setattr(module, "_uncached", {})
    monkeypatch.setattr(module, "_temporary_folders", [])
    return tmp_path / "cache" / "trimtab" / "codegen"


@pytest.fixture
def counted(tmp_path, require):
    """This machine's compiler, and a function that returns how often it ran."""
    require("compiler")
    real = find_compiler()
    assert real is not None
    program, count = tmp_path / "cc", tmp_path / "count"
    program.write_text(f'#!/bin/sh\necho x >> {count}\nexec {" ".join(real.command)} "$@"\n')
    program.chmod(0o755)
    return Compiler(command=(str(program),), identity="counted"), lambda: len(count.read_text().split())


def _three(compiler, *, native=False):
    return load_library(ctypes.CDLL, SOURCE, compiler, native=native).three()


def _cached(folder: Path) -> Path:
    (path,) = folder.rglob("*.so")
    return path


def test_library_key_follows_source_and_compiler():
    other = Compiler(command=FAKE.command, identity="fake 2")
    assert len({library_key("a", FAKE), library_key("b", FAKE), library_key("a", other)}) == 3


def test_load_library_compiles_once_and_leaves_nothing_else(cache, counted):
    compiler, runs = counted
    assert (_three(compiler), _three(compiler), runs()) == (3, 3, 1)
    (folder,) = cache.iterdir()
    assert list(folder.iterdir()) == [_cached(cache)]


def test_load_library_by_key_makes_its_source_once(cache, counted):
    compiler, _ = counted
    made = []

    def source():
        made.append(SOURCE)
        return SOURCE

    for _ in range(2):
        assert load_library(ctypes.CDLL, "three", compiler, source=source).three() == 3
    assert len(made) == 1


@pytest.mark.parametrize("content", [b"", b"not a library", None], ids=["empty", "other", "truncated"])
def test_damaged_library_in_the_cache_is_compiled_anew(cache, counted, content):
    compiler, runs = counted
    load_library(str, SOURCE, compiler)  # not loaded, so that the damage is not in this process
    path = _cached(cache)
    whole = path.read_bytes()
    path.write_bytes(whole[:2000] if content is None else content)
    assert (_three(compiler), runs()) == (3, 2)
    assert path.read_bytes() == whole


def test_library_that_cannot_be_loaded_is_compiled_anew(cache, counted):
    compiler, runs = counted
    load_library(str, SOURCE, compiler)
    path = _cached(cache)
    path.unlink()
    module._written(b"whole, but for another system", path.parent)
    assert (_three(compiler), runs()) == (3, 2)


def test_cache_of_another_machine_is_not_loaded(cache, counted, monkeypatch):
    compiler, runs = counted
    monkeypatch.setattr(module, "processor", lambda: "flags: sse2 avx512f")
    load_library(str, SOURCE, compiler, native=True)
    theirs = _cached(cache)
    monkeypatch.setattr(module, "processor", lambda: "flags: sse2")
    loaded = []
    load_library(loaded.append, SOURCE, compiler, native=True)
    assert runs() == 2
    assert Path(loaded[0]).parent != theirs.parent


@pytest.mark.skipif(not Path("/proc/cpuinfo").exists(), reason="this system has no /proc/cpuinfo")
def test_processor_has_the_instruction_sets_and_no_clock():
    lines = compiler_module.processor().lower()
    assert "flags" in lines or "features" in lines
    assert "mhz" not in lines


def test_full_disk_of_the_cache_compiles_for_this_run_with_one_line(cache, counted, monkeypatch, capsys):
    compiler, runs = counted
    replace = os.replace

    def full(source, target):
        if str(target).startswith(str(cache)):
            raise OSError(errno.ENOSPC, "No space left on device")
        replace(source, target)

    monkeypatch.setattr(os, "replace", full)
    assert (_three(compiler), _three(compiler), runs()) == (3, 3, 1)
    assert load_library(ctypes.CDLL, SOURCE + "\n", compiler).three() == 3
    assert [path for path in cache.rglob("*") if path.is_file()] == []
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("trimtab: no cache of compiled code")
    assert "No space left on device" in line


def test_full_disk_everywhere_raises(counted, monkeypatch):
    compiler, _ = counted

    def full(source, target):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(os, "replace", full)
    with pytest.raises(CodegenError, match=r"cannot be written or loaded: .*No space left"):
        _three(compiler)


def test_unwritable_directory_of_a_key_compiles_for_this_run(cache, counted, capsys):
    compiler, _ = counted
    cache_directory().joinpath(library_key(SOURCE, compiler)).touch()
    assert _three(compiler) == 3
    assert capsys.readouterr().err.count("\n") == 1


def test_cache_directory_that_cannot_be_made_is_a_temporary_one(tmp_path, monkeypatch, capsys):
    blocked = tmp_path / "file"
    blocked.touch()
    monkeypatch.setenv("XDG_CACHE_HOME", str(blocked))
    assert cache_directory().is_dir()
    assert cache_directory() == cache_directory()
    assert capsys.readouterr().err.count("\n") == 1


def test_two_processes_that_compile_the_same_both_load_it(cache, tmp_path, require):
    require("compiler")
    real = find_compiler()
    assert real is not None
    here = tmp_path / "here"
    here.mkdir()
    program = tmp_path / "cc"  # it waits until both have started
    program.write_text(
        f"#!/bin/sh\ntouch {here}/$$\nwhile [ $(ls {here} | wc -l) -lt 2 ]; do :; done\n"
        f'exec {" ".join(real.command)} "$@"\n'
    )
    program.chmod(0o755)
    code = (
        "import ctypes\n"
        "from trimtab.host.codegen.compiler import Compiler\n"
        "from trimtab.host.codegen.libraries import load_library\n"
        f"compiler = Compiler(command=({str(program)!r},), identity='both')\n"
        f"print(load_library(ctypes.CDLL, {SOURCE!r}, compiler).three())\n"
    )
    both = [
        subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True) for _ in range(2)
    ]
    assert [process.communicate()[0] for process in both] == ["3\n", "3\n"]
    assert len([path for path in cache.rglob("*") if path.is_file()]) == 1


@pytest.mark.parametrize("place", ["", "trimtab", "trimtab/codegen"])
def test_cache_that_others_can_change_is_not_used_and_one_line_says_so(
    cache, counted, tmp_path, monkeypatch, capsys, place
):
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    compiler, compiled = counted
    assert _three(compiler) == 3
    (tmp_path / "cache" / place).chmod(0o777)
    held = sorted(cache.rglob("*"))
    for _ in range(2):
        assert _three(compiler) == 3
    assert compiled() == 2
    assert sorted(cache.rglob("*")) == held
    line = capsys.readouterr().err
    assert line.count("\n") == 1
    assert f"everybody can write to {tmp_path / 'cache' / place}" in line
    assert stat.S_IMODE(cache_directory().stat().st_mode) == 0o700


@pytest.mark.skipif(os.geteuid() != 0, reason="gives files to another user, which needs root")
@pytest.mark.parametrize("which", ["library", "key", "cache"])
def test_library_of_another_user_is_compiled_anew(cache, counted, tmp_path, monkeypatch, capsys, which):
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    compiler, compiled = counted
    assert _three(compiler) == 3
    (library,) = cache.rglob("*.so")
    strange = {"library": library, "key": library.parent, "cache": cache}[which]
    os.chown(strange, 65534, -1)
    assert _three(compiler) == 3
    assert compiled() == 2
    told = capsys.readouterr().err
    assert ("" if which == "library" else "belongs to") in told
    assert told.count("\n") == (which != "library")


def test_cache_is_made_for_this_user_alone(cache, counted):
    old = os.umask(0)
    try:
        assert _three(counted[0]) == 3
    finally:
        os.umask(old)
    for folder in (cache, cache.parent, cache.parent.parent):
        assert stat.S_IMODE(folder.stat().st_mode) == 0o700


def test_cache_and_folder_of_the_process_that_vanish_are_made_anew(
    cache, counted, tmp_path, monkeypatch, capsys
):
    compiler, _ = counted
    assert _three(compiler) == 3
    shutil.rmtree(tmp_path / "cache")
    for folder in module._temporary_folders:
        shutil.rmtree(folder)
    assert _three(compiler) == 3
    assert len(list(cache.rglob("*.so"))) == 1
    assert capsys.readouterr().err == ""


def test_folder_of_a_key_that_vanishes_while_it_is_written_compiles_for_this_run(
    cache, counted, monkeypatch, capsys
):
    compiler, _ = counted
    make = module._make_private

    def vanish(folder):
        make(folder)
        if folder.parent == cache:
            folder.rmdir()

    monkeypatch.setattr(module, "_make_private", vanish)
    assert _three(compiler) == 3
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("trimtab: no cache of compiled code")
