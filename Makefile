# `make demo` and `make test` need Python 3.11 or newer and make; both set up .venv first.
# `make fuzz` gives 10^7 inputs to everything that takes bytes, and 10^5 damaged logs to each reader of foreign logs;
# FUZZ_SEED=n chooses others, FUZZ_INPUTS=n and FUZZ_LOGS=n their numbers. It also flies 10^4 random sequences against
# the invariants of a flight; POLICY_SEEDS=first:end chooses others.
# TRIMTAB_PYTHON=/path/to/python3 chooses the Python, TESTS=path narrows a test run, WORKERS=n its processes.

VENV := .venv
PYTHON := $(VENV)/bin/python
READY := $(VENV)/trimtab.stamp
READY_ALL := $(VENV)/trimtab-all.stamp
READY_BENCH := $(VENV)/trimtab-bench.stamp
READY_CLIENTS := $(VENV)/trimtab-clients.stamp
READY_PLANTS := $(VENV)/trimtab-plants.stamp
WORKERS ?= auto
TESTS ?=
FUZZ_INPUTS ?= 10000000
FUZZ_LOGS ?= 100000
FUZZ_SEED ?= 0
FUZZ_WORKERS ?= 2
POLICY_SEEDS ?= 0:10000
PYTEST = $(PYTHON) -m pytest -n $(WORKERS) --dist loadgroup
export TRIMTAB_PYTHON

.PHONY: venv demo test test-all lint style types bench fuzz generate docs

venv: $(READY)

$(READY): requirements.lock pyproject.toml .ci/venv
	@.ci/venv requirements.lock $@

$(READY_ALL): requirements-all.lock $(READY)
	@.ci/venv requirements-all.lock $@

$(READY_CLIENTS): requirements-clients.lock $(READY)
	@.ci/venv requirements-clients.lock $@

$(READY_PLANTS): requirements-plants.lock $(READY)
	@.ci/venv requirements-plants.lock $@

$(READY_BENCH): requirements-bench.lock $(READY)
	@.ci/venv requirements-bench.lock $@

demo: $(READY)
	$(VENV)/bin/trimtab demo

test: $(READY)
	$(PYTEST) -m "not full" $(TESTS)

test-all: $(READY_ALL) $(READY_CLIENTS) $(READY_PLANTS)
	$(PYTEST) $(TESTS)

lint: style types

style: $(READY_ALL)
	$(PYTHON) -m ruff check .
	$(PYTHON) -m ruff format --check .

types: $(READY_ALL)
	$(PYTHON) -m pyright

bench: $(READY_BENCH)
	$(VENV)/bin/trimtab bench

fuzz: $(READY_ALL)
	$(PYTHON) -m trimtab.sitl.studies.fuzz --inputs $(FUZZ_INPUTS) --seed $(FUZZ_SEED) --workers $(FUZZ_WORKERS)
	$(PYTHON) -m tests.fuzz.readers --inputs $(FUZZ_LOGS) --seed $(FUZZ_SEED)
	$(PYTHON) -m trimtab.sitl.studies.policy --seeds $(POLICY_SEEDS) --workers $(FUZZ_WORKERS)

generate: $(READY_ALL)
	$(PYTHON) -m trimtab.protocol.generate

docs: $(READY)
	$(PYTHON) docs/generators/effects.py docs/reference/effects.md
	$(PYTHON) docs/generators/manoeuvres.py docs/reference/manoeuvres.md
	$(PYTHON) docs/generators/rules.py docs/reference/tracing-rules.md
	$(PYTHON) docs/generators/bounds.py docs/reference/bounds.md
	$(PYTHON) docs/generators/failsafes.py docs/reference/failsafes.md
	$(PYTHON) docs/generators/api.py docs/reference/python.md
	$(PYTHON) -m trimtab.sitl.studies.upload_picture docs/concepts/upload.svg
