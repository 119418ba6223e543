# The main job on data_samples/: noise, calibrate, regularize, invert, estimate, compensate. The
# model sees the Q = 1 step alone; every other log is unseen. `make demo` calls it.
SHELL := bash
.SHELLFLAGS := -euo pipefail -c
.DELETE_ON_ERROR:
.SECONDARY:
.PHONY: all

THERMALTOOL ?= thermaltool
PYTHON ?= python3
OUT ?= demo
SAMPLES ?= data_samples
export OMP_NUM_THREADS ?= 1

FAR := dT_pair1_K
PAIRS := dT_pair1_K dT_pair2_K dT_pair3_K
DEFLECTIONS := d_x_um d_y_um
LOGS := step100 step050 step025 triangle duty
DESIGNS := far_kalman far_kernel all_kalman
BOTH := $(foreach log,$(LOGS),$(foreach design,$(DESIGNS),$(log).$(design)))
FIGURES := noise fit kernel triangle.far_kalman.setpoints \
    $(foreach log,$(LOGS),$(log).far_kalman $(log).far_kernel)

# What is soon made comes first, so that there is something to look at.
all: $(OUT)/figures/noise.png $(OUT)/figures/fit.png $(OUT)/bands.md $(OUT)/setpoints.md \
    $(FIGURES:%=$(OUT)/figures/%.png)
	@echo
	@echo "Deflection estimated from noisy temperatures; calibrated on step100 alone (bands.md):"
	@echo
	@cat $(OUT)/bands.md
	@echo
	@echo "After actuation in steps of 0.5 µm (setpoints.md):"
	@echo
	@cat $(OUT)/setpoints.md
	@echo
	@echo "Figures are in $(OUT)/figures/"

$(OUT) $(OUT)/figures:
	mkdir -p $@

$(OUT)/noise.json: $(SAMPLES)/frame_idle.parquet | $(OUT)
	$(THERMALTOOL) noise $< -o $@

$(OUT)/model.json: $(SAMPLES)/frame_step100.parquet | $(OUT)
	$(THERMALTOOL) calibrate $< --drive Q_main_1 $(PAIRS:%=--sensor %) \
	    $(DEFLECTIONS:%=--deflection %) $(PAIRS:%=--response %=conduction) \
	    $(DEFLECTIONS:%=--response %=deflection) -o $@

$(OUT)/far_%.json: $(OUT)/model.json $(OUT)/noise.json
	$(THERMALTOOL) regularize $< --noise $(OUT)/noise.json --sensor $(FAR) --form $* -q -o $@

$(OUT)/all_%.json: $(OUT)/model.json $(OUT)/noise.json
	$(THERMALTOOL) regularize $< --noise $(OUT)/noise.json --form $* -q -o $@

$(OUT)/kernel.parquet: $(OUT)/far_kernel.json
	$(THERMALTOOL) invert $< -o $@

# What a logger writes.
$(OUT)/%.csv: $(SAMPLES)/frame_%.parquet | $(OUT)
	$(THERMALTOOL) check $< -o $@ > $(@:.csv=.check.txt)

# One log through one design: LOG.DESIGN.estimate.parquet at once, LOG.DESIGN.setpoints.csv as a
# stream of lines.
define through
$(OUT)/$(1).$(2).estimate.parquet: $(OUT)/$(2).json $(SAMPLES)/frame_$(1).parquet
	$(THERMALTOOL) estimate $$^ -q -o $$@

$(OUT)/$(1).$(2).setpoints.csv: $(OUT)/$(2).json $(OUT)/$(1).csv
	cat $$(lastword $$^) | $(THERMALTOOL) compensate $$< --step 0.5 -q > $$@.part
	@mv $$@.part $$@
endef
$(foreach log,$(LOGS),$(foreach design,$(DESIGNS),$(eval $(call through,$(log),$(design)))))

$(OUT)/bands.md: $(DESIGNS:%=$(OUT)/%.json) $(LOGS:%=$(SAMPLES)/frame_%.parquet)
	$(PYTHON) benchmarks/deflection_bands.py $(SAMPLES) $(DESIGNS:%=$(OUT)/%.json) \
	    --must far_kalman --must far_kernel > $@.part
	@mv $@.part $@

$(OUT)/setpoints.md: $(foreach each,$(BOTH),$(OUT)/$(each).estimate.parquet $(OUT)/$(each).setpoints.csv)
	$(PYTHON) benchmarks/setpoints.py $(SAMPLES) $(OUT) $(BOTH) > $@.part
	@mv $@.part $@

$(OUT)/figures/noise.png: $(OUT)/noise.json | $(OUT)/figures
	$(THERMALTOOL) plot $< -o $@

$(OUT)/figures/fit.png: $(OUT)/model.json $(SAMPLES)/frame_step100.parquet | $(OUT)/figures
	$(THERMALTOOL) plot $^ -o $@

$(OUT)/figures/kernel.png: $(OUT)/kernel.parquet | $(OUT)/figures
	$(THERMALTOOL) plot $< -o $@

$(OUT)/figures/%.setpoints.png: $(OUT)/%.setpoints.csv | $(OUT)/figures
	$(THERMALTOOL) plot $< -o $@

# Without a suffix of its own: the estimate beside what was measured.
$(OUT)/figures/%.png: $(OUT)/%.estimate.parquet | $(OUT)/figures
	$(THERMALTOOL) plot $< --against $(SAMPLES)/frame_$(basename $*).parquet -o $@
