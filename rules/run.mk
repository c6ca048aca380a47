# How the recipe of an artifact runs: $(call step,MODULE WORDS) writes $@.part, and the wrapper publishes it (flow/step.py). Where
# command and contents of all prerequisites are those of its record, it only dates it anew.

# Jobs default to the cores of the machine; -jN on the command line wins. A make below this one shares its slots.
HAS_SLOTS ?=
ifeq ($(HAS_SLOTS)$(filter -j%,$(MAKEFLAGS)),)
MAKEFLAGS += -j$(JOBS)
endif
# Jobs of a program that runs several at a time by itself. Known when a recipe is expanded, not before.
SLOTS = $(or $(patsubst -j%,%,$(filter -j%,$(MAKEFLAGS))),$(JOBS))
export GELFORGE_JOBS = $(SLOTS)
# What of -n, -q and -t make was given, under which nothing is done.
ONLY_SHOWN = $(strip $(foreach f,n q t,$(findstring $f,$(firstword -$(MAKEFLAGS)))))
# Before the recipe of such a program: it then takes slots that are free (flow/jobs.py).
HANDS_SLOTS = $(if $(ONLY_SHOWN),,+)

# Every prerequisite is an input; more of them than a shell takes as one command (128 KiB) go by a list.
LIST = $D/00_plan/$(subst /,-,$@).inputs
INPUTS = $(if $(word 500,$^),@$(LIST)$(file >$(LIST),$^),$^)
wrapped = $(PY) -m gelforge.flow.step $@ $(INPUTS) -- $(PY) -m $(strip $1) --part
step = @$(wrapped)

# The first line of a long stage's recipe, expanded when make is about to begin it: once in a run it says how long all of that stage
# may take. How many cores a cluster gives is not known here.
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
# EXECUTOR=slurm: the shards of stage 30 are one job array, a training is a job, and all else runs where make runs. A recipe of stage
# 30 notes its command, and takes its outdated target away, so that make sees it change; `solved` waits until what was noted has run.
SLURM_PROFILE ?= workflow/slurm.toml
NOTES = $D/.slurm/$(GELFORGE_RUN)
note = $(shell mkdir -p $D/.slurm)$(file >>$(NOTES)$1,$@	$2)if [ -e $@ ]; then mv $@ $@.old; fi
slurm = $(PY) -m gelforge.flow.slurm $(NOTES)$1 --profile '$(SLURM_PROFILE)'
train = @$(if $(ONLY_SHOWN),$(wrapped),$(call note,-$(@F),$(wrapped)); exec $(call slurm,-$(@F)))
# A file that is asked for by its name is a job of its own.
BY_NAME := $(filter $D/%,$(MAKECMDGOALS))
solve = $(if $(BY_NAME),$(train),@$(if $(ONLY_SHOWN),$(wrapped),$(call note,,$(wrapped))))
solved := $(if $(BY_NAME),,solved)

.PHONY: solved
solved: $(SHARDS:%=$D/30_fea/%.csv)
	@$(if $(ONLY_SHOWN),,if [ -e $(NOTES) ]; then exec $(call slurm,); fi)
endif
