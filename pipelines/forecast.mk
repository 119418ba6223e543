# From a log of errors to its order, a model and forecasts. Copy it and call it:
#
#   make -f forecast.mk LOG=residual.csv COLUMN=d_z_um STEPS=20
#
# LOG      the log, blanks in its name allowed (they are _ in NAME); COLUMN what is forecast
# OUT      where everything goes (default: out)
# STEPS    samples ahead (default: 10)
# ORDER_FLAGS, FIT_FLAGS  further options of these commands (--difference 1 to both)
#
# OUT/NAME.orders.json and .orders.png (criteria of every order), .arma.json (the model that is best
# by BIC), .forecast.csv (time, forecast, low, high beyond the end of the log).
SHELL := bash
.SHELLFLAGS := -euo pipefail -c
.DELETE_ON_ERROR:
.SECONDARY:
.PHONY: all

THERMALTOOL ?= thermaltool
PYTHON ?= python3
OUT ?= out
STEPS ?= 10

$(foreach name,LOG COLUMN,$(if $($(name)),,$(error $(name)= is missing)))
empty :=
blank := $(empty) $(empty)
NAME := $(basename $(notdir $(subst $(blank),_,$(LOG))))
# Make parts names at blanks: as a source the log is escaped, in recipes it is quoted.
SOURCE := $(subst $(blank),\ ,$(LOG))

all: $(OUT)/$(NAME).forecast.csv

$(OUT):
	mkdir -p $@

$(OUT)/%.orders.json: $(SOURCE) | $(OUT)
	$(THERMALTOOL) order "$(LOG)" -C "$(COLUMN)" $(ORDER_FLAGS) --figure $(@:.json=.png) --json > $@.part
	mv $@.part $@

# The order is read off the table, so that another rule can be put in its place.
$(OUT)/%.arma.json: $(OUT)/%.orders.json $(SOURCE)
	order=$$($(PYTHON) -c \
	    'import json, sys; b = json.load(sys.stdin)["best"]["bic"]; print(b["p"], b["q"], sep=",")' < $<); \
	$(THERMALTOOL) fit "$(LOG)" -C "$(COLUMN)" $(FIT_FLAGS) --order "$$order" -o $@

$(OUT)/%.forecast.csv: $(OUT)/%.arma.json $(SOURCE)
	$(THERMALTOOL) forecast $< "$(LOG)" -C "$(COLUMN)" --steps $(STEPS) -o $@
