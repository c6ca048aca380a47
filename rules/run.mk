# How the recipe of an artifact runs: $(call step,MODULE WORDS) writes $@.part, and the wrapper renames it
# (flow/step.py). If the command and the contents of all prerequisites match the record, the wrapper only touches the
# target; else it says what changed.

# Jobs default to the cores of the machine; -jN on the command line takes precedence.
ifeq ($(filter -j%,$(MAKEFLAGS)),)
MAKEFLAGS += -j$(JOBS)
endif
# Job slots for a program that runs several jobs itself. Only known when a recipe is expanded.
SLOTS = $(or $(patsubst -j%,%,$(filter -j%,$(MAKEFLAGS))),$(JOBS))
export GELFORGE_JOBS = $(SLOTS)
# Prefix of the recipe of such a program: it then takes free slots (flow/jobs.py).
HANDS_SLOTS = $(if $(ONLY_SHOWN),,+)

# Every prerequisite is an input; if they exceed what a shell takes as one command (128 KiB), they are passed as a
# list file.
LIST = $D/00_plan/$(subst /,-,$@).inputs
INPUTS = $(if $(word 500,$^),@$(LIST)$(shell mkdir -p $D/00_plan)$(file >$(LIST),$(filter-out unsure,$^)),$(filter-out unsure,$^))
step = @$(LAUNCHED) $(PY) -m gelforge.flow.step $@ $(INPUTS) -- $(PY) -m $(strip $1) --part

# EXECUTOR=slurm: solves and trainings run as jobs of a cluster; make waits for each, so give it as many jobs as the
# cluster shall run at once: make -j200 fea EXECUTOR=slurm. The launcher stands in front of the command (flow/slurm.py).
LAUNCHED :=
ON_CLUSTER := GELFORGE_LAUNCHER='$(PY) -m gelforge.flow.slurm --profile $(or $(value SLURM_PROFILE),workflow/slurm.toml)'
