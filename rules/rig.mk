# Source rig: the virtual bench writes data/DATASET as a plan says, resumes where it stopped, and appends when a plan
# grows. Pictures that were removed, for example to give sensors another appearance, are drawn again from kept surfaces.
PLAN ?= workflow/rig/demo.toml
ifeq ($(origin REFERENCE),undefined)
REFERENCE := $(or $(value GELFORGE_REFERENCE),../shared/reference)
endif

.PHONY: rig rig-estimate rig-check
rig: $(SETUP)  ## simulate the presses of a plan, write them to data/: make rig PLAN=workflow/rig/train.toml
	@$(PY) -m gelforge.stages.rig --plan $(call given,PLAN) --data data --jobs $(SLOTS)

rig-estimate: $(SETUP)  ## estimate core hours, disk, memory and time of a plan, of a few presses: PLAN=FILE.toml
	@$(PY) -m gelforge.stages.rig --estimate --plan $(call given,PLAN) --data data --jobs $(SLOTS)

rig-check: $(SETUP)  ## run benchmark-rig; images of the rig beside real ones: results/rig-check/index.html
	@$(PY_HERE) -m tests.benchmarks.rig --reference $(call given,REFERENCE) --page results/rig-check/index.html

# The table that ships with `gelforge sensor --balls`; to solve it anew remove it first, rows that are there stay.
.PHONY: ball-table
ball-table: $(SETUP)  ## solve the missing rows of src/gelforge/networks/balls/balls.csv (three minutes for all)
	@$(PY_HERE) -m tests.benchmarks.ball_table
