# Source rig: the virtual bench writes data/DATASET as a plan says, resumes where it stopped, and appends when a plan grows.
PLAN ?= workflow/rig/demo.toml
REFERENCE ?= ../shared/reference

.PHONY: rig rig-check
rig: $(SETUP)  ## simulate the presses of a plan into data/: make rig PLAN=workflow/rig/train.toml
	@$(PY) -m gelforge.rig --plan "$(PLAN)" --data data --jobs $(or $(patsubst -j%,%,$(filter -j%,$(MAKEFLAGS))),$(JOBS))

rig-check: $(SETUP)  ## the rig's pictures beside real ones, with figures: results/rig-check/index.html
	@$(PY) -m gelforge.virtualrig.check --reference "$(REFERENCE)" --out results/rig-check/index.html
