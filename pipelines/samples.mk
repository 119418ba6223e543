# data_samples/ from the simulated machine: the commands of data_samples/README.md. `make samples`
# calls it; the logs come out the same.
SHELL := bash
.SHELLFLAGS := -euo pipefail -c
.DELETE_ON_ERROR:

THERMALTOOL ?= thermaltool
OUT ?= data_samples
PYTHON ?= python
export OMP_NUM_THREADS ?= 1

LOGS := idle step100 step050 step025 triangle duty
.PHONY: all $(LOGS) first junction machines
all: $(LOGS) first junction machines

idle: OPTIONS := --input idle --duration 7200 --seed 10
step100: OPTIONS := --input step --duration 9060 --seed 11
step050: OPTIONS := --input step --level 0.5 --duration 9060 --seed 12
step025: OPTIONS := --input step --level 0.25 --duration 9060 --seed 13
triangle: OPTIONS := --input triangle --duration 2460 --seed 14
duty: OPTIONS := --input duty --duration 9060 --seed 15

$(LOGS):
	$(THERMALTOOL) plant frame $(OPTIONS) -o $(OUT)/frame_$@.parquet

first:
	$(THERMALTOOL) plant frame --input step --duration 600 --seed 11 \
	    -o $(OUT)/frame_step100_first10min.csv

junction:
	$(PYTHON) benchmarks/spectrum.py log $(OUT)/junction_heating.csv

machines:
	$(PYTHON) data_samples/machines.py $(OUT)
