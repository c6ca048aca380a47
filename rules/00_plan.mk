# Stage 00: shards and stage parameters, made while make reads its files, so that `make -n` is exact.
D := results/$(DATASET)
P := $D/00_plan/params
DATA := data/$(DATASET)
PLANNED := $D/00_plan/plan.mk

# What labels are made with, once a calibration was frozen: a small file that only `make freeze` changes.
FROZEN := $(DATA)/calibration.toml
IS_FROZEN := $(wildcard $(FROZEN))

# What a plan is made from, beside the files that it names itself (PLAN_READS: catalogue and shapes).
PLAN_INPUTS := $(DATA)/log.csv $(DATA)/dataset.toml $(addprefix workflow/,params.toml charted.toml models.toml scenes.toml sensors.toml gels.toml) $(wildcard $(DATA)/sensors.toml $(DATA)/indenters.toml) $(IS_FROZEN) $(CCX_FOUND) $(wildcard src/gelforge/*/*.py src/gelforge/*/*/*.py)
PLAN_READS :=
PLAN_STATE :=
NEEDS_CALIBRATION :=
MODELS :=
TUNED :=
NEED_NOCONTACT :=
SHAPES :=
PICTURES :=
PICTURE_STATE :=

# Undefined before make reads its files anew, of which a make below another one would warn.
MAKE_RESTARTS ?=

# Goals that need no dataset do not read one.
NO_DATASET := help setup parameters lint format test test-% rig rig-% benchmark-% lock clean-% feats-fetch feats-import mcap-import projection real-check
# What was made of a dataset whose data are gone can still be seen.
NO_DATASET += $(if $(wildcard $(DATA)/log.csv),,$(if $(wildcard $D),status provenance))
# Results dated ahead of this machine's clock, by another machine or before its clock was set back: what is edited until then looks older
# than they are and would stay unread. A second look passes over what others write meanwhile, and clocks a moment apart.
AHEAD = find -H $D \( -path '$D/.*' -o -path '$D/30_fea/*/*' $(patsubst %,-o -path '$D/%',logs metrics samples estimate export feats look) \) -prune -o -type f
ahead = $(if $(wildcard $D),$(if $(shell $(AHEAD) -newermt now -print -quit),$(shell sleep 2; $(AHEAD) -newermt '1 second' -printf '%p is dated %TF %.8TT, ' -quit && date '+and here it is %F %T')))

ifneq ($(filter-out $(NO_DATASET),$(or $(MAKECMDGOALS),help)),)
ifneq ($(and $(if $(MAKE_RESTARTS),,first),$(filter-out status why provenance look,$(MAKECMDGOALS))),)
DATED_AHEAD := $(ahead)
ifneq ($(findstring is dated,$(DATED_AHEAD)),)
$(error $(DATED_AHEAD): make goes by dates, so what is edited before that time would stay unread. Set the clocks of all machines that write here alike and wait until then, or make DATASET=$(DATASET) clean-ahead, which removes what is dated ahead, but for solved presses, to be made again)
endif
endif
include $(PLANNED)
# The plan holds the time and size of every file that it was made from. They are compared for being the same, not for
# being newer: a file that an older one replaced is noticed, and one dated in the future is planned once, not for ever.
# A link counts as what it points to, and a fraction of a second has a point in every language, as in stages/plan.py.
ifneq ($(PLAN_STATE),$(if $(PLAN_STATE),$(shell LC_ALL=C stat -L -c '%n:%.9Y:%s' $(PLAN_INPUTS) $(PLAN_READS) 2>/dev/null)))
.PHONY: plan-again
$(PLANNED): plan-again
# Networks of before would refuse one that was added or changed since.
MODELS :=
TUNED :=
NEED_NOCONTACT :=
# So are those of all files in PICTURES, the folders that the log names, by a digest as stages/plan.py writes it: the time at
# which an entry changed, which no copy keeps.
else ifeq ($(MAKE_RESTARTS)$(if $(and $(PICTURES),$(wildcard $(PLANNED))),,none),)
ifneq ($(PICTURE_STATE),$(shell LC_ALL=C find -L $(PICTURES) -type f -printf '%p %s %C@\n' 2>/dev/null | LC_ALL=C sort | sha256sum | cut -c 1-32))
.PHONY: plan-again
$(PLANNED): plan-again
endif
endif
# Status makes nothing: without the shards' targets make starts in half the time.
ifeq ($(MAKECMDGOALS),status)
SHARDS :=
endif
else
SHARDS :=
MESHES :=
BRANCHES :=
REPORT_MODEL :=
LEARN_ALSO :=
endif

$(PLANNED): | $(SETUP) $(CCX_FOUND) $(DATA)/log.csv $(DATA)/dataset.toml
	@$(PY) -m gelforge.stages.plan --data $(DATA) --ccx "$$(cat $(CCX_FOUND))" --inputs $(PLAN_INPUTS) --out $@

$(DATA)/log.csv $(DATA)/dataset.toml:
	$(error $@ not found: DATASET=$(DATASET) needs a raw log and a dataset.toml, which workflow/guide/your-data.md describes; make rig writes simulated ones)

# $(call step,MODULE ARGUMENTS) is the recipe of every artifact: it writes $@.part, the wrapper publishes it.
# Of more inputs than a shell takes as one command (128 KiB) only the parameters are named; the others' reader refuses a
# broken one. What a network learns from or is fine-tuned from beside its dataset lies elsewhere.
LISTED = $(if $(word 1500,$^),$P/%,$D/% $(LEARNT_WITH) $(SHIPPED).onnx $(SHIPPED).safetensors)
wrapped = $(PY) -m gelforge.flow.step $@ $(filter $(LISTED),$^) -- $(PY) -m $(1)
ifeq ($(EXECUTOR),local)
step = @$(wrapped)
barrier =
else ifeq ($(EXECUTOR),slurm)
include rules/00_slurm.mk
else
$(error EXECUTOR=$(EXECUTOR): local or slurm is needed)
endif

# Of the plan's own files the table of shards stays: samples keep their shards by it.
.PHONY: clean-ahead
clean-ahead:  ## remove results dated ahead of this machine's clock, so that make makes them again; keeps solved presses
	@$(AHEAD) -newermt now ! -path '$D/00_plan/shards.csv' -print -exec rm -f {} +
	@touch -c $D/00_plan/shards.csv; rm -f $(PLANNED)
