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
# every file appears whole or not at all; nothing is written elsewhere. Names of logs may have
# blanks (they are _ in NAME), OUT none.
#
# A log that fails stops no other: its message is in OUT/NAME.*.failed and a line of the summary,
# and `all` ends with an error when everything else is made. The next run tries it again. A model
# whose sensor has no kernel (no response by diffusion) is no failure.
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
empty :=
blank := $(empty) $(empty)
# Make parts names at blanks: as a source a file is escaped, in recipes it is quoted.
escaped = $(subst $(blank),\ ,$(1))
# While logs are listed a blank is a slash, which no name of a file has.
FOUND := $(shell for log in "$(LOGS)"/*.csv "$(LOGS)"/*.parquet "$(LOGS)"/*.ndjson; do \
    if [ -e "$$log" ] && ! [ "$$log" -ef "$(IDLE)" ]; then basename "$$log"; fi; done | tr ' ' /)
named = $(basename $(subst /,_,$(1)))
NAMES := $(sort $(call named,$(FOUND)))
$(if $(NAMES),,$(error no logs in $(LOGS)/))
$(if $(filter $(words $(FOUND)),$(words $(NAMES))),,$(error two logs in $(LOGS)/ share a name))

made = $(NAMES:%=$(OUT)/%.$(1))
MAPPING := $(if $(MAP),--columns "$(MAP)")
CHANNELS := $(DRIVE:%=--drive %) $(SENSORS:%=--sensor %) $(DEFLECTIONS:%=--deflection %)

FIGURES := $(foreach figure,fit estimate kernel,$(call made,$(figure).png)) $(OUT)/noise.png

DESIGNS := $(foreach what,model kalman kernel,$(call made,$(what).json))
TABLES := $(call made,estimate.parquet)
# Responses that do not start by diffusion have no kernel: that is told, and is no failure.
KERNELS := $(call made,kernel.parquet)

all: $(OUT)/summary.csv $(FIGURES)
	@grep -sH "" $(addsuffix .failed,$(KERNELS)) >&2 || true
	@failures=$$(grep -sH "" $(addsuffix .failed,$(DESIGNS) $(TABLES) $(FIGURES)) || true); \
	    [ -z "$$failures" ] || { echo "$$failures" >&2; exit 1; }

# Runs a command for a target. Where it fails, the last line of what it says goes to TARGET.failed;
# where the source is missing because its own command failed, the target is left out. A signal
# (status above 128) ends the run.
define ATTEMPT
target=$$0 source=$$1 status=0
shift
rm -f "$$target.failed"
if ! [ -e "$$source" ]; then rm -f "$$target"; exit 0; fi
"$$@" 2> "$$target.part" || status=$$?
cat "$$target.part" >&2
if [ $$status != 0 ]; then
    rm -f "$$target"
    [ $$status -lt 128 ] || { rm -f "$$target.part"; exit $$status; }
    tail -n 1 "$$target.part" > "$$target.failed"
    [ -s "$$target.failed" ] || echo "status $$status" > "$$target.failed"
fi
rm -f "$$target.part"
endef
export ATTEMPT
attempt = bash -c "$$ATTEMPT" $@ "$<"

# The options are a source like the logs: with other ones everything is made again.
export OPTIONS := $(strip $(CHANNELS) $(MAPPING) $(CALIBRATE_FLAGS) / $(KERNEL_SENSOR) $(REGULARIZE_FLAGS))
ifneq ($(OPTIONS),$(strip $(file <$(OUT)/options.txt)))
$(OUT)/options.txt: FORCE
endif
$(OUT)/options.txt: | $(OUT)
	@printf "%s\n" "$$OPTIONS" > $@

$(OUT):
	mkdir -p $@

$(OUT)/noise.json: $(call escaped,$(IDLE)) $(call escaped,$(MAP)) | $(OUT)
	$(THERMALTOOL) noise "$<" $(MAPPING) -o $@ > /dev/null

$(OUT)/noise.png: $(OUT)/noise.json
	$(THERMALTOOL) plot $< -o $@

# What needs the log itself: its name, and its file as a source.
define fit
$(OUT)/$(1).model.json: $(2) $(call escaped,$(MAP)) $(OUT)/options.txt
	$$(attempt) $(THERMALTOOL) calibrate "$$<" $(CHANNELS) $(MAPPING) $(CALIBRATE_FLAGS) -q -o $$@

$(OUT)/$(1).estimate.parquet: $(OUT)/$(1).kalman.json $(2)
	$$(attempt) $(THERMALTOOL) estimate $$< "$(3)" $(MAPPING) -q -o $$@

$(OUT)/$(1).fit.png: $(OUT)/$(1).model.json $(2)
	$$(attempt) $(THERMALTOOL) plot $$< "$(3)" $(MAPPING) -o $$@

$(OUT)/$(1).estimate.png: $(OUT)/$(1).estimate.parquet $(2)
	$$(attempt) $(THERMALTOOL) plot $$< --against "$(3)" $(MAPPING) -o $$@
endef
located = $(LOGS)/$(subst /, ,$(1))
$(foreach log,$(FOUND),$(eval \
    $(call fit,$(call named,$(log)),$(call escaped,$(call located,$(log))),$(call located,$(log)))))

$(OUT)/%.kalman.json: $(OUT)/%.model.json $(OUT)/noise.json
	$(attempt) $(THERMALTOOL) regularize $< --noise $(OUT)/noise.json --form kalman \
	    $(REGULARIZE_FLAGS) -q -o $@

$(OUT)/%.kernel.json: $(OUT)/%.model.json $(OUT)/noise.json
	$(attempt) $(THERMALTOOL) regularize $< --noise $(OUT)/noise.json --form kernel \
	    --sensor $(KERNEL_SENSOR) $(REGULARIZE_FLAGS) -q -o $@

$(OUT)/%.kernel.parquet: $(OUT)/%.kernel.json
	$(attempt) $(THERMALTOOL) invert $< -o $@

$(OUT)/%.kernel.png: $(OUT)/%.kernel.parquet
	$(attempt) $(THERMALTOOL) plot $< -o $@

# One row for each log and output: the fit, what the designs promise ("predicted"), and what
# `estimate` finds of it on the next log that has a model ("judged": none of it was in the fit); or
# why a log failed.
define SUMMARY
import csv, json, os, shlex, subprocess, sys

target, folder, mapping, tool, *files = sys.argv[1:]
stem = os.path.join(os.path.dirname(target), "")
logs = {os.path.splitext(f.replace("/", "_"))[0]: f.replace("/", " ") for f in files}
logs = {name: os.path.join(folder, logs[name]) for name in sorted(logs)}
forms = ("kalman", "kernel")

def failures(name):
    failed = [f"{stem}{name}.{what}.json.failed" for what in ("model", *forms)]
    return [open(path).read().strip() for path in failed if os.path.exists(path)]

def judged(name, form, other):
    call = [*shlex.split(tool), "estimate", f"{stem}{name}.{form}.json", logs[other], "--json",
            "-q", "--nan-policy", "omit"]
    call += ["--columns", mapping] if mapping else []
    done = subprocess.run(call, stdout=subprocess.PIPE)
    return json.loads(done.stdout)["agreement"] if done.returncode == 0 else {}

heading = ["log", "output", "rmse", "fit_percent"]
heading += [f"{form}_{what}" for form in forms for what in ("predicted_band", "lag_s")]
heading += ["judged_on", *(f"{form}_judged_{what}" for form in forms for what in ("band", "rmse"))]
heading += ["failure"]
rows = [heading]
good = [name for name in logs if not failures(name)]
for name in logs:
    if failures(name):
        rows.append([name, *[""] * (len(heading) - 2), "; ".join(failures(name))])
        continue
    other = good[(good.index(name) + 1) % len(good)]
    found = [judged(name, form, other) if other != name else {} for form in forms]
    designs = [json.load(open(f"{stem}{name}.{form}.json"))["design"] for form in forms]
    for output in json.load(open(f"{stem}{name}.model.json"))["outputs"]:
        channel, fit = output["channel"], output["fit"]
        row = [name, channel, f"{fit['rmse']:.4g}", f"{fit['fit_percent']:.2f}"]
        for design in designs:
            band = dict(zip(design["outputs"], design["predicted"]["band"])).get(channel)
            lag = f"{design['predicted']['lag']:.1f}"
            row += ["", ""] if band is None else [f"{band:.3g}", lag]
        errors = [each.get(channel, {}) for each in found]
        row += [other if any(errors) else ""]
        row += [f"{e[what]:.3g}" if e else "" for e in errors for what in ("band", "rmse")]
        rows.append([*row, ""])
with open(target + ".part", "w", newline="") as stream:
    csv.writer(stream).writerows(rows)
os.replace(target + ".part", target)
widths = [max(map(len, column)) for column in zip(*rows)]
for row in rows:
    print("  ".join(cell.ljust(width) for cell, width in zip(row, widths)).rstrip())
endef
export SUMMARY

$(OUT)/summary.csv: $(DESIGNS)
	@$(PYTHON) -c "$$SUMMARY" $@ "$(LOGS)" "$(MAP)" "$(THERMALTOOL)" $(FOUND)
