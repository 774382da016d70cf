"""The C compiler: found in order, its flags, its failures, and the portable path that follows them."""

from __future__ import annotations

import os
import stat
from pathlib import Path

import pytest

from trimtab.host.codegen import compiler as module
from trimtab.host.codegen.compiler import (
    CodegenError,
    Compiler,
    compiled,
    engine_choice,
    find_compiler,
    run_compiler,
)

FAKE = Compiler(command=("no-such-compiler",), identity="fake 1")


_FIND = 'for each; do [ "$before" = -o ] && library="$each"; before="$each"; done'
"""Shell that sets $library to the file that a compiler is asked to write."""


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


@pytest.mark.parametrize(
    ("script", "message"),
    [
        ("echo 'math.h: not found' >&2; exit 1", r"C compiler cc failed: math\.h: not found"),
        ("exit 3", "C compiler cc failed: exit code 3"),
        (f'{_FIND}; echo part > "$library"; exit 1', "C compiler cc failed: exit code 1"),
        ("kill -9 $$", "C compiler cc failed: it was ended by signal 9"),
        ("exit 0", "C compiler cc made no usable library"),
        (f'{_FIND}; echo part > "$library"', "C compiler cc made no usable library"),
    ],
)
def test_run_compiler_that_fails_raises_in_one_line(tmp_path, script, message):
    program = _program(tmp_path / "bin", "cc", script)
    with pytest.raises(CodegenError, match=message) as caught:
        run_compiler("int x;", Compiler(command=(str(program),), identity="script"), tmp_path)
    assert "\n" not in str(caught.value)


def test_run_compiler_that_writes_half_a_library_raises(tmp_path, require):
    require("compiler")
    real = find_compiler()
    assert real is not None
    script = f'{_FIND}; {" ".join(real.command)} "$@" && truncate -s 2000 "$library"'
    program = _program(tmp_path / "bin", "cc", script)
    with pytest.raises(CodegenError, match="made no usable library"):
        run_compiler("int x = 3;", Compiler(command=(str(program),), identity="script"), tmp_path)


def test_run_compiler_of_a_missing_program_raises(tmp_path):
    with pytest.raises(CodegenError, match="does not run"):
        run_compiler("int x;", FAKE, tmp_path)


def test_compiled_with_a_failing_compiler_is_none_and_one_line_for_all(monkeypatch, capsys):
    def fail(compiler):
        raise CodegenError(f"{compiler.name} failed")

    monkeypatch.setattr(module, "find_compiler", lambda: FAKE)
    monkeypatch.setattr(module, "_warned", set())
    monkeypatch.delenv("TRIMTAB_ENGINE", raising=False)
    assert [compiled(fail), compiled(fail, "auto"), compiled(fail, "vm")] == [None, None, None]
    assert capsys.readouterr().err == (
        "trimtab: no-such-compiler failed; continuing without compiled code, slower\n"
    )
    assert compiled(lambda compiler: compiler.identity) == "fake 1"
    with pytest.raises(CodegenError, match="no-such-compiler failed"):
        compiled(fail, "c")


def test_flags_are_native_only_where_the_processor_is_known(monkeypatch):
    monkeypatch.setattr(module, "processor", lambda: "")
    assert not [flag for flag in module.flags(native=True) if flag.startswith("-m")]


def test_flags_keep_ieee_arithmetic():
    assert "-ffp-contract=off" in module.FLAGS
    assert not any("fast" in flag for flag in module.FLAGS)
