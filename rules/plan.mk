# Stage 00: shards and lists of names, which make must know before it reads the rules of the stages.
D := results/$(DATASET)
P := $D/00_plan/params
SHARD := $D/00_plan/shards
BESIDE := $D/00_plan/beside
DATA := data/$(DATASET)
IMPORTED := $(wildcard $(DATA)/labels)
PLANNED := $D/00_plan/plan.mk

# Goals that need no plan, and those that show results even if their log is gone.
NO_PLAN := help setup lint format lock docs test test-all benchmark-% lerobot-env real-check readme-pictures rig rig-check \
    fea-challenge feats-fetch feats-import mcap-import projection clean-%
OF_RESULTS := status provenance
NEEDS_PLAN := $(filter-out $(NO_PLAN) $(if $(wildcard $(DATA)/log.csv),,$(if $(wildcard $D/.),$(OF_RESULTS))),$(GOALS))

# The plan's lists, empty if no plan is read. PLANNED_FROM: files that it read because others name them, such as images.
LISTS := SHARDS BRANCHES PARETO_SCENES MODELS TUNED NEED_NOCONTACT LEARNER REPORT_MODEL CALIBRATION LEARN_ALSO IMAGES GELS MESHED_GELS CHARTED_GELS PARAMETERS PLANNED_FROM
$(foreach v,$(LISTS),$(eval $v :=))

ifneq ($(NEEDS_PLAN),)
$(call refuse,$(if $(wildcard $(DATA)/log.csv),,no),$(DATA)/log.csv not found: DATASET=$(DATASET) needs a raw log and a dataset.toml$(comma) \
    which workflow/guide/your-data.md describes; make rig writes simulated ones)
# -n, -q and -t run nothing, and so no set-up: without it, or without a plan, make cannot know what it would do.
$(call refuse,$(and $(ONLY_SHOWN),$(if $(and $(wildcard $(SETUP)),$(wildcard $(CCX_FOUND))),,no)),not set up yet: run make setup; -n and -q install nothing)
include $(PLANNED)
endif

# Folders are prerequisites, because a file that is removed has no date. Twice, because words of a name with blanks are
# no files.
PLAN_INPUTS := $(wildcard $(wildcard $(DATA) $(DATA)/log.csv $(DATA)/*.toml $(DATA)/nocontact $(DATA)/nocontact/* $(DATA)/labels $(DATA)/labels/*.npz \
    $(DATA)/splits.csv $(DATA)/truth $(DATA)/truth/*.csv workflow/*.toml src/gelforge/stages/*.py src/gelforge/flow/*.py)) $(PLANNED_FROM)

$(PLANNED): $(PLAN_INPUTS) $(wildcard $(CCX_FOUND)) | $(SETUP) $(CCX_FOUND)
	$(STEP)

# A file of the plan that was removed is written again, and those of networks and scenes for the first goal that needs
# them: the plan writes them where their folder exists.
$D/00_plan/%: | $(PLANNED)
	@test -e $@ || { mkdir -p $(@D); $(PY) -m gelforge.stages.plan $D >/dev/null; }

# A file that the plan read and that is gone: the plan is made again without it.
$(filter-out $(wildcard $(PLANNED_FROM)),$(PLANNED_FROM)):

# The network that the report shows: that of MODEL=, else that of [report] if it has this grid, else the one that is
# trained if none is named. Of the shipped network there is one grid.
SHIPPED_RES := 24x32
OF_ITS_GRID := $(if $(filter-out $(SHIPPED_RES),$(RES1)),$(filter-out shipped $(TUNED),$(REPORT_MODEL)),$(REPORT_MODEL))
NET := $(or $(value MODEL),$(OF_ITS_GRID),$(LEARNER))
# The one that `make train` makes. Models that fine-tune the shipped network (TUNED) are made by name only.
LEARNT := $(filter-out shipped,$(NET))
LEARNT := $(or $(LEARNT),$(LEARNER))
LEARNABLE := $(filter-out $(TUNED),$(MODELS))

# Other datasets to train on as well ([train] also). Each is made by its own run of make.
LEARNT_WITH := $(foreach name,$(LEARN_ALSO),results/$(name)/60_dataset/$(if $(wildcard data/$(name)/labels/1x1.npz),1x1,$(RES1))/dataset.json)

# What goals need, checked before anything is made: as a recipe, because that is expanded once the plan is up to date.
asks = $(filter $1,$(GOALS))
TRAINS := $(call asks,train ship)
NEEDED := $(sort $(if $(call asks,evaluate report demo),$(NET)) $(if $(TRAINS),$(LEARNT)) $(if $(call asks,pareto-models),$(LEARNABLE)))
PICTURED := $(firstword $(filter $(NEED_NOCONTACT) shipped,$(NEEDED)))
CAME := $(notdir $(basename $(wildcard $(DATA)/labels/*.npz)))
IMPOSSIBLE = \
    $(call refuse,$(filter-out $(MODELS) shipped,$(NET)),MODEL=$(NET): no such network; workflow/models.toml has: $(MODELS)$(comma) \
        and shipped is the one that ships) \
    $(call refuse,$(and $(filter shipped,$(value MODEL)),$(TRAINS)),MODEL=shipped: the shipped network was trained elsewhere; to \
        $(firstword $(TRAINS))$(comma) name one of $(MODELS)) \
    $(call refuse,$(and $(filter $(TUNED),$(value MODEL)),$(filter-out $(SHIPPED_RES),$(RES1))),MODEL=$(value MODEL) fine-tunes the \
        shipped network$(comma) whose grid is $(SHIPPED_RES): say RES=$(SHIPPED_RES)$(comma) or name another network) \
    $(call refuse,$(and $(call asks,ship),$(if $(value MODEL),,no)),ship: replaces the shipped network; name the new one: make ship \
        MODEL=… DATASET=…) \
    $(call refuse,$(and $(call asks,ship),$(filter-out $(SHIPPED_RES),$(RES1))),ship RES=$(RES1): the shipped network has a grid of \
        $(SHIPPED_RES); train a network with that grid: RES=$(SHIPPED_RES)) \
    $(call refuse,$(and $(call asks,dataset evaluate export feats-export pareto-models train ship),$(if $(IMPORTED)$(IMAGES),,no)),$(DATA)/log.csv: \
        names no images$(comma) or [params.poses] images = false$(comma) so that its flow ends at labels and calibrate: run make report \
        DATASET=$(DATASET)$(comma) or write the image of each press into the column image) \
    $(call refuse,$(and $(IMPORTED),$(filter-out $(CAME),$(RES))),$(DATA) was imported with labels of $(CAME)$(comma) not of $(firstword \
        $(filter-out $(CAME),$(RES))): say RES=$(firstword $(CAME))) \
    $(call refuse,$(and $(PICTURED),$(IMPORTED)$(IMAGES),$(if $(wildcard $(DATA)/nocontact),,no)),MODEL=$(PICTURED) reads a picture \
        beside a no-contact image$(comma) and $(DATA)/nocontact is missing: add nocontact/SENSOR.png of each sensor$(comma) or name a \
        network that reads the image alone$(comma) such as unet ([params.report] model in $(DATA)/dataset.toml)) \
    $(foreach file,$(filter-out $(wildcard $(LEARNT_WITH)),$(LEARNT_WITH)),$(call refuse,$(filter-out shipped,$(NEEDED)),$(file) is \
        missing$(comma) and [train] also asks for it: make DATASET=$(word 2,$(subst /, ,$(file))) RES=$(word 4,$(subst /, ,$(file))) dataset))
.PHONY: possible
possible: ; $(strip $(IMPOSSIBLE))

# Status makes nothing: without targets for the shards make starts in half the time.
ifeq ($(MAKECMDGOALS),status)
SHARDS :=
endif
