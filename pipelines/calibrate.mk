# From a folder of logs to models, designs, kernels, figures and a summary. Copy it and call it:
#
#   make -j4 -f calibrate.mk LOGS=logs IDLE=idle.csv DRIVE=Q_main_1 \
#        SENSORS="dT_pair1_K dT_pair2_K" DEFLECTIONS="d_x_um d_y_um"
#
# LOGS         folder with *.csv, *.parquet, *.ndjson; each log gives a model of its own
# IDLE         log of the machine at rest: the noise of its sensors
# DRIVE        known input in the logs; SENSORS what estimates it; DEFLECTIONS what is computed
# OUT          where everything goes (default: out)
# MAP          map of foreign column names, where they need one
# KERNEL_SENSOR  sensor of the kernel form (default: the first of SENSORS)
# CALIBRATE_FLAGS, REGULARIZE_FLAGS  further options of these commands
#
# For each log OUT/NAME.model.json, .kalman.json and .kernel.json (the model with a design),
# .kernel.parquet, .estimate.parquet, and the figures .fit.png, .estimate.png, .kernel.png; for all
# of them noise.json, noise.png and summary.csv. Only what is older than its source or made with other options is made again;
# every file appears whole or not at all; nothing is written elsewhere. Make cannot quote blanks
# in file names.
SHELL := bash
.SHELLFLAGS := -euo pipefail -c
.DELETE_ON_ERROR:
.SECONDARY:
.PHONY: all FORCE

THERMALTOOL ?= thermaltool
PYTHON ?= python3
LOGS ?= logs
OUT ?= out
KERNEL_SENSOR ?= $(firstword $(SENSORS))
# Make runs the logs in parallel: one core for each process is enough.
export OMP_NUM_THREADS ?= 1

$(foreach name,IDLE DRIVE SENSORS DEFLECTIONS,$(if $($(name)),,$(error $(name)= is missing)))
FOUND := $(filter-out $(IDLE),$(foreach format,csv parquet ndjson,$(wildcard $(LOGS)/*.$(format))))
NAMES := $(sort $(basename $(notdir $(FOUND))))
$(if $(NAMES),,$(error no logs in $(LOGS)/))
$(if $(filter $(words $(FOUND)),$(words $(NAMES))),,$(error two logs in $(LOGS)/ share a name))

made = $(NAMES:%=$(OUT)/%.$(1))
MAPPING := $(MAP:%=--columns %)
CHANNELS := $(DRIVE:%=--drive %) $(SENSORS:%=--sensor %) $(DEFLECTIONS:%=--deflection %)

FIGURES := $(foreach figure,fit estimate kernel,$(call made,$(figure).png)) $(OUT)/noise.png

all: $(OUT)/summary.csv $(FIGURES)

# The options are a source like the logs: with other ones everything is made again.
export OPTIONS := $(strip $(CHANNELS) $(MAPPING) $(CALIBRATE_FLAGS) / $(KERNEL_SENSOR) $(REGULARIZE_FLAGS))
ifneq ($(OPTIONS),$(strip $(file <$(OUT)/options.txt)))
$(OUT)/options.txt: FORCE
endif
$(OUT)/options.txt: | $(OUT)
	@printf "%s\n" "$$OPTIONS" > $@

$(OUT):
	mkdir -p $@

$(OUT)/noise.json: $(IDLE) $(MAP) | $(OUT)
	$(THERMALTOOL) noise $< $(MAPPING) -o $@ > /dev/null

$(OUT)/noise.png: $(OUT)/noise.json
	$(THERMALTOOL) plot $< -o $@

define fit
$(OUT)/%.model.json: $(LOGS)/%.$(1) $(MAP) $(OUT)/options.txt
	$(THERMALTOOL) calibrate $$< $(CHANNELS) $(MAPPING) $(CALIBRATE_FLAGS) -q -o $$@

$(OUT)/%.estimate.parquet: $(OUT)/%.kalman.json $(LOGS)/%.$(1)
	$(THERMALTOOL) estimate $$^ $(MAPPING) -q -o $$@

$(OUT)/%.fit.png: $(OUT)/%.model.json $(LOGS)/%.$(1)
	$(THERMALTOOL) plot $$^ $(MAPPING) -o $$@

$(OUT)/%.estimate.png: $(OUT)/%.estimate.parquet $(LOGS)/%.$(1)
	$(THERMALTOOL) plot $$< --against $$(lastword $$^) $(MAPPING) -o $$@
endef
$(foreach format,csv parquet ndjson,$(eval $(call fit,$(format))))

$(OUT)/%.kalman.json: $(OUT)/%.model.json $(OUT)/noise.json
	$(THERMALTOOL) regularize $< --noise $(OUT)/noise.json --form kalman $(REGULARIZE_FLAGS) -q -o $@

$(OUT)/%.kernel.json: $(OUT)/%.model.json $(OUT)/noise.json
	$(THERMALTOOL) regularize $< --noise $(OUT)/noise.json --form kernel --sensor $(KERNEL_SENSOR) \
	    $(REGULARIZE_FLAGS) -q -o $@

$(OUT)/%.kernel.parquet: $(OUT)/%.kernel.json
	$(THERMALTOOL) invert $< -o $@

$(OUT)/%.kernel.png: $(OUT)/%.kernel.parquet
	$(THERMALTOOL) plot $< -o $@

# One row for each log and output: the fit, and what the designs promise.
define SUMMARY
import csv, json, os, sys

target, *names = sys.argv[1:]
heading = ["log", "output", "rmse", "fit_percent"]
heading += [f"{form}_{what}" for form in ("kalman", "kernel") for what in ("band", "lag_s")]
rows = [heading]
for name in names:
    stem = os.path.join(os.path.dirname(target), name)
    designs = [json.load(open(f"{stem}.{form}.json"))["design"] for form in ("kalman", "kernel")]
    for output in json.load(open(f"{stem}.model.json"))["outputs"]:
        channel, fit = output["channel"], output["fit"]
        row = [name, channel, f"{fit['rmse']:.4g}", f"{fit['fit_percent']:.2f}"]
        for design in designs:
            band = dict(zip(design["outputs"], design["predicted"]["band"])).get(channel)
            lag = f"{design['predicted']['lag']:.1f}"
            row += ["", ""] if band is None else [f"{band:.3g}", lag]
        rows.append(row)
with open(target + ".part", "w", newline="") as stream:
    csv.writer(stream).writerows(rows)
os.replace(target + ".part", target)
widths = [max(map(len, column)) for column in zip(*rows)]
for row in rows:
    print("  ".join(cell.ljust(width) for cell, width in zip(row, widths)).rstrip())
endef
export SUMMARY

$(OUT)/summary.csv: $(call made,model.json) $(call made,kalman.json) $(call made,kernel.json)
	@$(PYTHON) -c "$$SUMMARY" $@ $(NAMES)
