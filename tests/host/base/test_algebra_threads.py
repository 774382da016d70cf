"""Threads of linear algebra: bounded while public functions work, whatever the environment says."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from typing import Any

import pytest

from trimtab.host.base.workers import process_pool

SHOW = """
import json, sys
from threadpoolctl import threadpool_info
def threads():
    return sorted((i["filepath"].rpartition("/")[2].partition("-")[0].partition(".")[0], i["num_threads"])
                  for i in threadpool_info() if i["user_api"] == "blas")
"""
WITHIN = """
from importlib import import_module
from trimtab.host.base import parallel
module, function, inner, arguments, keywords = json.loads(sys.argv[1])
home = import_module(module)
class Reached(Exception): pass
def reach(*arguments, **keywords):
    raise Reached(threads())
setattr(home, inner, reach)
before = threads()
try:
    getattr(home, function)(*arguments, **keywords)
except Reached as reached:
    print(json.dumps([before, reached.args[0], threads()]))
"""


def answer_of(script: str, *words: str) -> Any:
    """What a process prints in which two threads of linear algebra are asked for."""
    done = subprocess.run(
        [sys.executable, "-c", SHOW + script, *words],
        env={**os.environ, "OPENBLAS_NUM_THREADS": "2"},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


@pytest.mark.parametrize(
    ("module", "function", "inner", "arguments", "keywords"),
    [
        ("trimtab.host.trace.run", "run", "read_logs", [[], [], {}], {}),
        ("trimtab.host.learn.learn", "learn", "mocap_latency_s", [[]], {}),
        ("trimtab.host.plan.planner", "plan", "parse_kind", [None, None], {}),
        ("trimtab.host.plan.rounds", "plan_shooting", "_begin", [None], {"nodes": 20}),
        ("trimtab.host.compare.prediction", "predict", "load_effects", [None, [None]], {}),
        ("trimtab.host.compare.comparison", "compare", "_files", [None, None, None], {}),
    ],
)
def test_public_functions_work_in_one_thread_of_algebra(
    module: str, function: str, inner: str, arguments: list[Any], keywords: dict[str, Any]
) -> None:
    before, within, after = answer_of(WITHIN, json.dumps([module, function, inner, arguments, keywords]))
    assert before
    assert {count for _, count in before} == {2}
    assert {count for _, count in within} == {1}
    assert after == before


def test_context_bounds_the_library_of_casadi_once_it_is_loaded() -> None:
    within = answer_of("""
import casadi
from trimtab.host.base.parallel import one_thread_of_algebra
casadi.load_nlpsol("ipopt")
with one_thread_of_algebra():
    print(json.dumps(threads()))
""")
    assert ["libcasadi", 1] in within


def test_worker_process_keeps_to_one_thread_of_algebra(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("OPENBLAS_NUM_THREADS", "2")
    counts = (
        "[each['num_threads'] for each in __import__('threadpoolctl').threadpool_info()"
        " if each['user_api'] == 'blas']"
    )
    with process_pool(1) as pool:
        assert pool.submit(eval, counts).result() == [1, 1]  # of numpy and of scipy
