# Source rig: the virtual bench writes data/DATASET as a plan says, resumes where it stopped, and appends when a plan
# grows. Pictures that were removed, for example to give sensors another appearance, are drawn again from kept surfaces.
PLAN ?= workflow/rig/demo.toml
# The folder of real pictures, where it is not that of GELFORGE_REFERENCE (tests/benchmarks/figures.py).
AT_REFERENCE = $(if $(value REFERENCE),--reference $(call given,REFERENCE))

rig: $(SETUP)  ## simulate the presses of a plan, write them to data/: make rig PLAN=workflow/rig/train.toml
	@$(PY) -m gelforge.stages.rig --plan $(call given,PLAN) --data data --jobs $(SLOTS)

rig-estimate: $(SETUP)  ## estimate core hours, disk, memory and time of a plan, of a few presses: PLAN=FILE.toml
	@$(PY) -m gelforge.stages.rig --estimate --plan $(call given,PLAN) --data data --jobs $(SLOTS)

rig-check: $(SETUP)  ## run benchmark-rig; images of the rig beside real ones: results/rig-check/index.html
	@$(PY_HERE) -m tests.benchmarks.rig $(AT_REFERENCE) --page results/rig-check/index.html
