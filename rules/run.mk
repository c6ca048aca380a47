# How the recipe of an artifact runs: $(call step,MODULE WORDS) writes $@.part, and the wrapper renames it
# (flow/step.py). If the command and the contents of all prerequisites match the record, the wrapper only touches the
# target.

# Jobs default to the cores of the machine; -jN on the command line takes precedence.
ifeq ($(filter -j%,$(MAKEFLAGS)),)
MAKEFLAGS += -j$(JOBS)
endif
# Job slots for a program that runs several jobs itself. Only known when a recipe is expanded.
SLOTS = $(or $(patsubst -j%,%,$(filter -j%,$(MAKEFLAGS))),$(JOBS))
export GELFORGE_JOBS = $(SLOTS)
# Those of -n, -q and -t that make was given: it then runs nothing.
ONLY_SHOWN = $(strip $(foreach f,n q t,$(findstring $f,$(firstword -$(MAKEFLAGS)))))
# Prefix of the recipe of such a program: it then takes free slots (flow/jobs.py).
HANDS_SLOTS = $(if $(ONLY_SHOWN),,+)

# Every prerequisite is an input; if they exceed what a shell takes as one command (128 KiB), they are passed as a
# list file.
LIST = $D/00_plan/$(subst /,-,$@).inputs
INPUTS = $(if $(word 500,$^),@$(LIST)$(file >$(LIST),$^),$^)
wrapped = $(PY) -m gelforge.flow.step $@ $(INPUTS) -- $(PY) -m $(strip $1) --part
step = @$(wrapped)

# The first line of a long stage's recipe, expanded when make is about to run it: once per run it prints how long the
# whole stage may take. Not on a cluster, whose number of cores is not known here.
BELOW = $(@:$D/%=%)
STAGE_OF = $(firstword $(subst /, ,$(BELOW)))
foretold = $(if $(ONLY_SHOWN)$(filter-out local,$(EXECUTOR))$(filter $(STAGE_OF),$(FORETOLD)),,$(eval FORETOLD += $(STAGE_OF))@$(PY) \
    -m gelforge.commands.estimate $D --ahead $(BELOW) --cores $(SLOTS))
FORETOLD :=

ifeq ($(EXECUTOR),local)
solve = $(step)
train = $(step)
solved :=
else
# EXECUTOR=slurm: the shards of stage 30 are one job array, a training is a job, and everything else runs where make
# runs. A recipe of stage 30 only notes its command and moves its outdated target away, so that make sees it change;
# `solved` runs the noted commands and waits for them.
SLURM_PROFILE ?= workflow/slurm.toml
NOTES = $D/.slurm/$(GELFORGE_RUN)
note = $(shell mkdir -p $D/.slurm)$(file >>$(NOTES)$1,$@	$2)if [ -e $@ ]; then mv $@ $@.old; fi
slurm = $(PY) -m gelforge.flow.slurm $(NOTES)$1 --profile '$(SLURM_PROFILE)'
train = @$(if $(ONLY_SHOWN),$(wrapped),$(call note,-$(@F),$(wrapped)); exec $(call slurm,-$(@F)))
# A file that is requested by its name is a separate job.
BY_NAME := $(filter $D/%,$(MAKECMDGOALS))
solve = $(if $(BY_NAME),$(train),@$(if $(ONLY_SHOWN),$(wrapped),$(call note,,$(wrapped))))
solved := $(if $(BY_NAME),,solved)

.PHONY: solved
solved: $(SHARDS:%=$D/30_fea/%.csv)
	@$(if $(ONLY_SHOWN),,if [ -e $(NOTES) ]; then exec $(call slurm,); fi)
endif
