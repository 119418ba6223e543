# Measured logs that this project did not make: calibrated on one part, judged on another that the
# fit has not seen. `make measured` calls it; docs/results/study.md says why these options.
SHELL := bash
.SHELLFLAGS := -euo pipefail -c
.DELETE_ON_ERROR:
.SECONDARY:
.PHONY: all

THERMALTOOL ?= thermaltool
PYTHON ?= python3
DATA ?= ../shared/data
OUT ?= demo/measured
export OMP_NUM_THREADS ?= 1

SETS := gantry heating_system hairdryer

# TRAIN and TEST are the logs, OPTIONS the calibration, JUDGED the rows of TEST that count.
gantry.TRAIN := $(DATA)/gantry/run_2021-06-13_morning.csv
gantry.TEST := $(DATA)/gantry/run_2021-06-13_evening.csv
gantry.OPTIONS := --drive T_bed_degC --deflection d_z_um --response d_z_um=deflection
gantry.JUDGED :=

heating_system.TRAIN := $(DATA)/daisy/heating_system.csv
heating_system.TEST := $(heating_system.TRAIN)
heating_system.OPTIONS := --drive U_lamp_V --sensor T_plate_degC --reference 6 --stop 800 \
    --response T_plate_degC=deflection
heating_system.JUDGED := --start 802

hairdryer.TRAIN := $(DATA)/daisy/hairdryer_ljung.csv
hairdryer.TEST := $(hairdryer.TRAIN)
hairdryer.OPTIONS := --drive U_heater_V --sensor U_air_V --reference 4.91 --initial free \
    --stop 39.96 --response U_air_V=joint_deflection
hairdryer.JUDGED := --start 40

ifeq ($(wildcard $(DATA)/gantry $(DATA)/daisy),)
all:
	@echo "measured logs: left out, there is no $(DATA) here (they are not copied into the project)"
else
all: $(OUT)/measured.md $(SETS:%=$(OUT)/%.png)
	@cat $(OUT)/measured.md
	@echo
	@echo "Measured, simulated and residual are in $(OUT)/*.parquet and *.png"
endif

$(OUT):
	mkdir -p $@

define measured
$(OUT)/$(1).model.json: $($(1).TRAIN) | $(OUT)
	$(THERMALTOOL) calibrate $$< --columns data_samples/maps/$(1).toml $($(1).OPTIONS) -o $$@

# The report of the agreement comes with the table.
$(OUT)/$(1).held_out.json: $(OUT)/$(1).model.json $($(1).TEST)
	$(THERMALTOOL) simulate $$^ --columns data_samples/maps/$(1).toml $($(1).JUDGED) \
	    -o $(OUT)/$(1).simulated.parquet --json > $$@.part
	@mv $$@.part $$@

$(OUT)/$(1).png: $(OUT)/$(1).model.json $($(1).TEST)
	$(THERMALTOOL) plot $$^ --columns data_samples/maps/$(1).toml -o $$@
endef
$(foreach set,$(SETS),$(eval $(call measured,$(set))))

define TABLE
import json, sys

print("| log | output | rmse, trained | fit %, trained | rmse, held out | fit %, held out "
      "| max | mean | rows |")
print("|---|---|---|---|---|---|---|---|---|")
folder, *names = sys.argv[1:]
for name in names:
    model = json.load(open(f"{folder}/{name}.model.json"))
    for channel, held in json.load(open(f"{folder}/{name}.held_out.json")).items():
        fit = next(o["fit"] for o in model["outputs"] if o["channel"] == channel)
        print(f"| {name} | {channel} | {fit['rmse']:.3g} | {fit['fit_percent']:.1f} "
              f"| {held['rmse']:.3g} | {held['fit_percent']:.1f} | {held['max_error']:.3g} "
              f"| {held['mean']:.2g} | {held['rows']} |")
endef
export TABLE

$(OUT)/measured.md: $(SETS:%=$(OUT)/%.held_out.json)
	$(PYTHON) -c "$$TABLE" $(OUT) $(SETS) > $@.part
	@mv $@.part $@
