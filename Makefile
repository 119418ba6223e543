# make demo     the main job on data_samples/: tables, and figures in demo/figures
# make test     the tests but the longest, which make test-slow runs; CI: both. make test-study:
#               tests of minutes, mostly longer forms; part of make study
# make lint     ruff, mypy, import direction
# make bench    speed as ratios in one run, memory by the row, diagnose beside what a user would pick
# make study    error bands over fresh noise, hidden effects, the measured logs
# make hidden   hidden effects alone; make measured: the measured logs alone
# make exam     machines of other physics, known and unknown trouble: 455 logs; not in CI
# make docs     the site of docs/ in site/; docs/reference/commands/ again, from --help
# make samples  data_samples/ again, from the simulated machine
# Each sets up .venv from requirements.lock by itself.
SHELL := bash
.SHELLFLAGS := -euo pipefail -c
.DELETE_ON_ERROR:
.PHONY: demo test test-slow test-study lint bench study hidden exam measured samples docs lock clean

PYTHON ?= python3
BIN := .venv/bin
READY := .venv/.ready
# The peers' own packages, apart from those of the project.
BENCH := .venv-bench/bin
BENCH_READY := .venv-bench/.ready
# Those of `identify` apart again: one of them admits no newer numpy.
BENCH_IDENTIFY := .venv-bench-identify/bin
BENCH_IDENTIFY_READY := .venv-bench-identify/.ready
DOCS := .venv-docs/bin
DOCS_READY := .venv-docs/.ready
TOOLS := THERMALTOOL=$(CURDIR)/$(BIN)/thermaltool PYTHON=$(CURDIR)/$(BIN)/python
export PIP_DISABLE_PIP_VERSION_CHECK := 1

$(READY): requirements.lock pyproject.toml
	$(PYTHON) -m venv .venv
	$(BIN)/python -m pip install --quiet --require-hashes -r requirements.lock
	$(BIN)/python -m pip install --quiet --no-deps --no-build-isolation -e .
	touch $@

$(BENCH_READY): requirements-bench.lock
	$(PYTHON) -m venv .venv-bench
	$(BENCH)/python -m pip install --quiet --require-hashes -r requirements-bench.lock
	touch $@

$(BENCH_IDENTIFY_READY): requirements-bench-identify.lock
	$(PYTHON) -m venv .venv-bench-identify
	$(BENCH_IDENTIFY)/python -m pip install --quiet --require-hashes -r requirements-bench-identify.lock
	touch $@

$(DOCS_READY): requirements-docs.lock
	$(PYTHON) -m venv .venv-docs
	$(DOCS)/python -m pip install --quiet --require-hashes -r requirements-docs.lock
	touch $@

demo: $(READY)
	@$(MAKE) --no-print-directory -j2 -f pipelines/demo.mk $(TOOLS)

# One thread for each of two workers: more would wait for each other. Bytecode is kept, even where
# the environment says not to: else each process that a test starts compiles the tool again.
PYTEST := PYTHONDONTWRITEBYTECODE= OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 $(BIN)/python -m pytest -n 2 --dist worksteal

test: $(READY)
	$(PYTEST) -m "not slow and not study"

test-slow: $(READY)
	$(PYTEST) -m slow --durations=40

test-study: $(READY)
	$(PYTEST) -m study --durations=40

lint: $(READY)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

bench: $(READY) $(BENCH_READY) $(BENCH_IDENTIFY_READY)
	@$(BIN)/python benchmarks/speed.py
	@$(BIN)/python benchmarks/memory.py
	@$(BIN)/python benchmarks/laplace.py
	@$(BIN)/python benchmarks/modes.py body
	@PYTHONPATH=$(CURDIR) $(BENCH)/python benchmarks/peers.py
	@PYTHONPATH=$(CURDIR) $(BENCH)/python benchmarks/orders.py speed
	@PYTHONPATH=$(CURDIR) $(BENCH)/python benchmarks/streaming.py
	@PYTHONPATH=$(CURDIR) $(BENCH_IDENTIFY)/python benchmarks/identify.py speed
	@PYTHONPATH=$(CURDIR) $(BENCH_IDENTIFY)/python benchmarks/identify_process.py
	@$(BIN)/python benchmarks/identify_states.py

DESIGNS := demo/far_kalman.json demo/far_kernel.json demo/all_kalman.json

study: $(READY) test-study
	@$(MAKE) --no-print-directory -j2 -f pipelines/demo.mk $(TOOLS) $(DESIGNS)
	@$(BIN)/python benchmarks/deflection_bands.py data_samples $(DESIGNS) --repeat 20
	@$(BIN)/python benchmarks/deflection_bands.py data_samples $(DESIGNS) --repeat 20 --signal 2.54
	@$(BIN)/python benchmarks/smoothing.py
	@$(BIN)/python benchmarks/alarm.py
	@$(BIN)/python benchmarks/walls.py
	@$(BIN)/python benchmarks/deconvolution.py rules
	@$(BIN)/python benchmarks/deconvolution.py wall
	@$(BIN)/python benchmarks/modes.py logs
	@for what in rod axis design; do $(BIN)/python benchmarks/placement.py $$what; done
	@$(BIN)/python benchmarks/boring_bar.py
	@$(BIN)/python benchmarks/orders.py study
	@$(BIN)/python benchmarks/identify.py coverage
	@$(BIN)/python benchmarks/identify_process.py coverage
	@$(BIN)/python benchmarks/identify_between.py
	@$(BIN)/python benchmarks/identify_heat.py
	@$(BIN)/python benchmarks/identify_spindle.py
	@$(BIN)/python benchmarks/identify_dropped.py
	@$(BIN)/python benchmarks/identify.py measured
	@$(BIN)/python benchmarks/validation.py
	@$(BIN)/python benchmarks/spectrum.py coverage
	@$(BIN)/python benchmarks/heaters.py
	@$(BIN)/python benchmarks/heater_control.py
	@$(BIN)/python benchmarks/heater_loops.py
	@$(BIN)/python benchmarks/heater_cases.py
	@$(BIN)/python benchmarks/stumbles.py
	@$(BIN)/python benchmarks/stream_faults.py
	@$(BIN)/python tests/faults/streams.py --count 10000
	@$(BIN)/python tests/faults/mutations.py --count 10000
	@$(MAKE) --no-print-directory hidden
	@$(MAKE) --no-print-directory measured

hidden: $(READY)
	@$(BIN)/python benchmarks/hidden_effects.py --figures docs/figures

exam: $(READY)
	@$(BIN)/python benchmarks/exam.py

measured: $(READY)
	@$(MAKE) --no-print-directory -j2 -f pipelines/measured.mk $(TOOLS)
	@$(MAKE) --no-print-directory -j2 -f pipelines/diagnosed.mk $(TOOLS)

samples: $(READY)
	@$(MAKE) --no-print-directory -j2 -f pipelines/samples.mk $(TOOLS)

# Strict: a broken link is an error (with --quiet it is none).
docs: $(READY) $(DOCS_READY)
	$(BIN)/python docs/commands.py
	NO_MKDOCS_2_WARNING=1 $(DOCS)/python -m mkdocs build --strict
	@echo "site: site/index.html"

lock:
	uv pip compile --universal --generate-hashes --no-emit-index-url --extra all --group dev pyproject.toml -o requirements.lock
	uv pip compile --universal --generate-hashes --no-emit-index-url --extra all --group bench -c requirements.lock pyproject.toml -o requirements-bench.lock
	uv pip compile --universal --generate-hashes --no-emit-index-url --extra all --group bench-identify pyproject.toml -o requirements-bench-identify.lock
	uv pip compile --universal --generate-hashes --no-emit-index-url --group docs -o requirements-docs.lock

clean:
	rm -rf demo build dist site
