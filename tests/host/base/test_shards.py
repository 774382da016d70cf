"""Shards of a study: each computes its part, and the merged folder gives the result of one run."""

from __future__ import annotations

import json
from concurrent.futures import Executor, Future

import pytest

from trimtab.host import cli
from trimtab.host.base import pieces as pieces_module
from trimtab.host.base import shards as shards_module
from trimtab.host.base.errors import UsageError
from trimtab.host.base.pieces import Piece, run_pieces
from trimtab.host.base.shards import ShardDone, merge, parse_shard

SETTINGS = {"seed": 1, "worlds": None, "quick": True}
PIECES = [Piece(name=f"{k:02d}", kind="square", arguments={"k": k}, weight=1.0 + k) for k in range(7)]


@pytest.fixture(autouse=True)
def in_this_process(monkeypatch):
    class Here(Executor):
        def submit(self, fn, /, *args, **kwargs):
            future: Future = Future()
            future.set_result(fn(*args, **kwargs))
            return future

    monkeypatch.setattr(pieces_module, "process_pool", lambda jobs: Here())


def _square(piece, folder):
    return piece.arguments["k"] ** 2


def _run(folder, shard=None, *, config=None):
    folder.mkdir(exist_ok=True)
    return run_pieces(
        PIECES, _square, folder=folder, config=config or {"study": "squares"}, jobs=1, shard=shard
    )


def _shards(tmp_path, count):
    folders = [tmp_path / f"shard-{index}" for index in range(1, count + 1)]
    for index, folder in enumerate(folders, start=1):
        with pytest.raises(ShardDone):
            _run(folder, parse_shard(f"{index}/{count}", SETTINGS))
    return folders


def _bytes(folder):
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


@pytest.mark.parametrize("count", [2, 3])
def test_merged_shards_are_the_bytes_of_one_run(tmp_path, count):
    whole = _run(tmp_path / "whole")
    folders = _shards(tmp_path, count)
    assert sum(len(list((folder / "pieces").iterdir())) for folder in folders) == len(PIECES)
    merge(folders, tmp_path / "merged", SETTINGS)
    assert _bytes(tmp_path / "merged")["pieces/03.json"] == _bytes(tmp_path / "whole")["pieces/03.json"]
    assert _run(tmp_path / "merged") == whole
    assert _bytes(tmp_path / "merged") == _bytes(tmp_path / "whole")


def test_last_shard_in_a_shared_folder_has_the_result(tmp_path):
    with pytest.raises(ShardDone, match="shard 1/2: 4 of 7 pieces"):
        _run(tmp_path / "shared", parse_shard("1/2", SETTINGS))
    assert _run(tmp_path / "shared", parse_shard("2/2", SETTINGS)) == _run(tmp_path / "whole")


def test_merge_of_other_settings_configuration_or_program_is_refused(tmp_path, monkeypatch):
    folders = _shards(tmp_path, 2)
    with pytest.raises(UsageError, match="a shard with seed 1, worlds None, quick True; give the same"):
        merge(folders, tmp_path / "merged", {**SETTINGS, "seed": 2})
    with pytest.raises(ShardDone):
        _run(tmp_path / "other", parse_shard("2/2", SETTINGS), config={"study": "cubes"})
    with pytest.raises(UsageError, match=r"not of the same study .*: another study"):
        merge([folders[0], tmp_path / "other"], tmp_path / "merged", SETTINGS)
    monkeypatch.setattr(shards_module, "git_state", lambda: "another commit")
    with pytest.raises(ShardDone):
        _run(tmp_path / "later", parse_shard("2/2", SETTINGS))
    with pytest.raises(UsageError, match=r"not of the same study .*: another program"):
        merge([folders[0], tmp_path / "later"], tmp_path / "merged", SETTINGS)
    assert not (tmp_path / "merged").exists()


def test_a_study_that_records_its_program_is_merged_with_it(tmp_path):
    config = {"study": "squares", "program": ["1.0", "abc"]}
    for k in (1, 2):
        with pytest.raises(ShardDone):
            _run(tmp_path / str(k), parse_shard(f"{k}/2", SETTINGS), config=config)
    merge([tmp_path / "1", tmp_path / "2"], tmp_path / "merged", SETTINGS)
    assert _run(tmp_path / "merged", config=config) == _run(tmp_path / "whole")


def test_merge_of_a_folder_without_a_shard_is_refused(tmp_path):
    _run(tmp_path / "whole")
    for folder in (tmp_path / "whole", tmp_path / "missing"):
        with pytest.raises(UsageError, match="holds no shard"):
            merge([folder], tmp_path / "merged", SETTINGS)


def test_merge_joins_ledgers_and_keeps_other_files(tmp_path):
    folders = _shards(tmp_path, 2)
    for number, folder in enumerate(folders):
        (folder / "ledger.json").write_text(f'{{"{number}": "hash {number}"}}')
        (folder / "worlds" / str(number)).mkdir(parents=True)
        (folder / "worlds" / str(number) / "log").write_bytes(b"log")
    merged = tmp_path / "merged"
    merge(folders[::-1], merged, SETTINGS)
    ledger = json.loads((merged / "ledger.json").read_text())
    assert list(ledger.items()) == [("0", "hash 0"), ("1", "hash 1")]  # in no order of the folders
    assert sorted(path.parent.name for path in merged.rglob("log")) == ["0", "1"]
    (folders[1] / "ledger.json").write_text('{"0": "another hash"}')
    with pytest.raises(UsageError, match=r"ledger\.json: differs from"):
        merge(folders, merged, SETTINGS)


def test_merge_of_pieces_that_differ_is_refused(tmp_path):
    folders = _shards(tmp_path, 2)
    path = folders[0] / "pieces" / "01.json"
    path.write_text("{}")
    with pytest.raises(UsageError, match=r"01\.json: differs from"):
        merge(folders, tmp_path / "merged", SETTINGS)


@pytest.mark.parametrize("text", ["0/2", "3/2", "1", "1/0", "a/b", "-1/2", "1/2/3"])
def test_study_with_a_wrong_shard_ends_with_code_2(tmp_path, capsys, text):
    assert cli.main(["study", "link", "--workspace", str(tmp_path), f"--shard={text}"]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line == f"trimtab: --shard {text}: give I/N with I from 1 to N, such as 1/4"


def test_study_without_shards_and_both_options_end_with_code_2(tmp_path, capsys):
    words = ["study", "controller-tuning", "--workspace", str(tmp_path)]
    assert cli.main([*words, "--shard", "1/2"]) == 2
    assert "--shard is not an option of study controller-tuning" in capsys.readouterr().err
    assert cli.main([*words, "--merge", str(tmp_path)]) == 2
    assert "--merge is not an option of study controller-tuning" in capsys.readouterr().err
    assert cli.main(["study", "link", "--shard", "1/2", "--merge", str(tmp_path)]) == 2
    assert "give --shard or --merge, not both" in capsys.readouterr().err
