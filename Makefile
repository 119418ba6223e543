# make demo     the main job on data_samples/: tables, and figures in demo/figures
# make test     the tests; make lint: ruff, mypy, import direction
# make bench    speed as ratios measured in one run
# make study    error bands over fresh noise, and the measured logs; make measured: these alone
# make docs     docs/commands/ again, from --help
# make samples  data_samples/ again, from the simulated machine
# Each sets up .venv from requirements.lock by itself.
SHELL := bash
.SHELLFLAGS := -euo pipefail -c
.DELETE_ON_ERROR:
.PHONY: demo test lint bench study measured samples docs lock clean

PYTHON ?= python3
BIN := .venv/bin
READY := .venv/.ready
TOOLS := THERMALTOOL=$(CURDIR)/$(BIN)/thermaltool PYTHON=$(CURDIR)/$(BIN)/python
export PIP_DISABLE_PIP_VERSION_CHECK := 1

$(READY): requirements.lock pyproject.toml
	$(PYTHON) -m venv .venv
	$(BIN)/python -m pip install --quiet --require-hashes -r requirements.lock
	$(BIN)/python -m pip install --quiet --no-deps --no-build-isolation -e .
	touch $@

demo: $(READY)
	@$(MAKE) --no-print-directory -j2 -f pipelines/demo.mk $(TOOLS)

test: $(READY)
	$(BIN)/python -m pytest -n 2

lint: $(READY)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

bench: $(READY)
	@$(BIN)/python benchmarks/speed.py

DESIGNS := demo/far_kalman.json demo/far_kernel.json demo/all_kalman.json

study: $(READY)
	@$(MAKE) --no-print-directory -j2 -f pipelines/demo.mk $(TOOLS) $(DESIGNS)
	@$(BIN)/python benchmarks/deflection_bands.py data_samples $(DESIGNS) --repeat 20
	@$(MAKE) --no-print-directory measured

measured: $(READY)
	@$(MAKE) --no-print-directory -j2 -f pipelines/measured.mk $(TOOLS)

samples: $(READY)
	@$(MAKE) --no-print-directory -j2 -f pipelines/samples.mk $(TOOLS)

docs: $(READY)
	$(BIN)/python docs/commands.py

lock:
	uv pip compile --universal --generate-hashes --no-emit-index-url --group dev pyproject.toml -o requirements.lock

clean:
	rm -rf demo build dist
