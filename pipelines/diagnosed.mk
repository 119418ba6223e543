# What `diagnose` says of measured logs that this project did not make, beside what is publicly known
# of them (docs/results/study.md). `make measured` calls it.
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

MORNING := $(DATA)/gantry/run_2021-06-13_morning.csv
EVENING := $(DATA)/gantry/run_2021-06-13_evening.csv
PLATE := $(DATA)/daisy/heating_system.csv
SPINDLE := $(DATA)/cnc_spindle/spindle_first_28h.csv

CASES := gantry gantry_before gantry_after gantry_header heating heating_half spindle_heat spindle_growth

# MAP, LOGS and MORE are what diagnose gets, MODEL its model, WRITTEN what it writes; TRAIN and PLAN
# make the model, with the kinds of response that `calibrate` chooses.
gantry.MAP := gantry
gantry.TRAIN := $(MORNING)
gantry.PLAN := --drive T_frame_degC --deflection d_z_um
gantry.LOGS := $(MORNING)
gantry.MORE := --validate $(EVENING)
gantry.WRITTEN := $(OUT)/gantry.extended.json

# The evening run alone, by the model as calibrated in the morning and as extended then: in the JSON,
# residuals.d_z_um.conditions, heating and cooling.
gantry_before.MAP := gantry
gantry_before.MODEL := $(OUT)/gantry.calibrated.json
gantry_before.LOGS := $(EVENING)
gantry_after.MAP := gantry
gantry_after.MODEL := $(OUT)/gantry.extended.json
gantry_after.LOGS := $(EVENING)

# One header says 12.5 um per step: the evening run as its header has it.
gantry_header.MAP := gantry
gantry_header.MODEL := $(OUT)/gantry.extended.json
gantry_header.LOGS := $(MORNING) $(OUT)/gantry_header.csv

# The lamp has burnt for long at the first row, and gives nothing at 0 V.
heating.MAP := heating_system
heating.TRAIN := $(PLATE)
heating.PLAN := --drive U_lamp_V --sensor T_plate_degC --reference 0 --initial free
heating.LOGS := $(PLATE)
heating_half.MAP := heating_system
heating_half.TRAIN := $(OUT)/heating_half.csv
heating_half.PLAN := --drive U_lamp_V --sensor T_plate_degC
heating_half.LOGS := $(OUT)/heating_half.csv

spindle_heat.MAP := cnc_spindle
spindle_heat.TRAIN := $(SPINDLE)
spindle_heat.PLAN := --drive n_spindle_rpm --sensor T_t5_degC --initial free
spindle_heat.LOGS := $(SPINDLE)
spindle_growth.MAP := cnc_spindle
spindle_growth.TRAIN := $(SPINDLE)
spindle_growth.PLAN := --drive T_t5_degC --deflection d_ch3_um --initial free
spindle_growth.LOGS := $(SPINDLE)

ifeq ($(wildcard $(DATA)/gantry $(DATA)/daisy),)
all:
	@echo "measured logs: left out, there is no $(DATA) here (they are not copied into the project)"
else
all: $(CASES:%=$(OUT)/%.md) $(CASES:%=$(OUT)/%.simulated)
	@for case in $(CASES); do echo; sed '/^$$/q' $(OUT)/$$case.md; done
	@echo "The figures of each report beside simulate with the model as it came and as it was written:"
	@echo
	@sed -n 1,2p $(firstword $(CASES:%=$(OUT)/%.simulated)); sed 1,2d -s $(CASES:%=$(OUT)/%.simulated)
	@echo
	@echo "Whole reports, with figures, are in $(OUT)/*.md"
endif

$(OUT):
	mkdir -p $@

$(OUT)/gantry_header.csv: $(EVENING) | $(OUT)
	awk -F, -v OFS=, '/^#/ {print; next} !seen {for (k = 1; k <= NF; k++) if ($$k == "mcu_pos_z") \
	    seen = k; print; next} {$$seen = 5 * $$seen; print}' $< > $@

$(OUT)/heating_half.csv: $(PLATE) | $(OUT)
	sed 402q $< > $@

define diagnosed
$(1).MODEL ?= $(OUT)/$(1).calibrated.json
$(1).WRITTEN ?= $(OUT)/$(1).written.json

$(OUT)/$(1).calibrated.json: $($(1).TRAIN) | $(OUT)
	$(THERMALTOOL) calibrate $$< --columns data_samples/maps/$($(1).MAP).toml $($(1).PLAN) -o $$@

$(OUT)/$(1).md: $$($(1).MODEL) $($(1).LOGS)
	$(THERMALTOOL) diagnose $$^ --columns data_samples/maps/$($(1).MAP).toml $($(1).MORE) \
	    -o $$($(1).WRITTEN) --report $(OUT)/$(1).report.md > $(OUT)/$(1).json 2> $$@.part || case $$$$? in 3|4) ;; *) false ;; esac
	@sed -n '/^The model/,$$$$p' $$@.part > $$@
	@rm $$@.part

$(OUT)/$(1).simulated: $(OUT)/$(1).md benchmarks/as_simulated.py
	@$(PYTHON) benchmarks/as_simulated.py $(OUT)/$(1).json --model $$($(1).MODEL) \
	    --written $$($(1).WRITTEN) --columns data_samples/maps/$($(1).MAP).toml > $$@
endef
$(foreach case,$(CASES),$(eval $(call diagnosed,$(case))))

$(OUT)/gantry.extended.json: $(OUT)/gantry.md
