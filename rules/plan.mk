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
LISTS := SHARDS BRANCHES PARETO_SCENES MODELS TUNED NEED_NOCONTACT LEARNER REPORT_MODEL CALIBRATION LEARN_ALSO IMAGES GELS MESHED_GELS CHARTED_GELS PLANNED_FROM
$(foreach v,$(LISTS),$(eval $v :=))

ifneq ($(NEEDS_PLAN),)
$(if $(wildcard $(DATA)/log.csv),,$(error $(DATA)/log.csv not found: DATASET=$(DATASET) needs a raw log and a dataset.toml, which \
    workflow/guide/your-data.md describes; make rig writes simulated ones))
# -n, -q and -t run nothing, and so no set-up: without it, or without a plan, make cannot know what it would do.
$(if $(ONLY_SHOWN),$(if $(wildcard $(SETUP)),,$(error not set up yet: run make setup; -n and -q install nothing)))
include $(PLANNED)
endif

# Folders are prerequisites, because a file that is removed has no date.
PLAN_INPUTS := $(wildcard $(DATA) $(DATA)/log.csv $(DATA)/*.toml $(DATA)/nocontact $(DATA)/nocontact/* $(DATA)/labels $(DATA)/labels/*.npz \
    $(DATA)/splits.csv $(DATA)/truth $(DATA)/truth/*.csv workflow/*.toml src/gelforge/stages/*.py src/gelforge/flow/*.py) $(PLANNED_FROM)

$(PLANNED): $(PLAN_INPUTS) $(wildcard $(CCX_FOUND)) | $(SETUP) $(CCX_FOUND)
	$(call step,gelforge.stages.plan $D --ccx $(CCX_FOUND))

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

asks = $(filter $1,$(GOALS))
TRAINS := $(call asks,train ship)
$(if $(MODELS),$(if $(filter $(MODELS) shipped,$(NET)),,$(error MODEL=$(value MODEL): no such network; workflow/models.toml has: \
    $(MODELS), and shipped is the one that ships)))
$(if $(and $(filter shipped,$(value MODEL)),$(TRAINS)),$(error MODEL=shipped: the shipped network was trained elsewhere; to \
    $(firstword $(TRAINS)), name one of $(MODELS)))
$(if $(and $(filter $(TUNED),$(value MODEL)),$(filter-out $(SHIPPED_RES),$(RES1))),$(error MODEL=$(value MODEL) fine-tunes the shipped \
    network, whose grid is $(SHIPPED_RES): say RES=$(SHIPPED_RES), or name another network))
$(if $(call asks,ship),$(if $(value MODEL),,$(error ship: replaces the shipped network; name the new one: make ship MODEL=… DATASET=…)))
$(if $(and $(call asks,ship),$(filter-out $(SHIPPED_RES),$(RES1))),$(error ship RES=$(RES1): the shipped network has a grid of \
    $(SHIPPED_RES); train a network with that grid: RES=$(SHIPPED_RES)))
$(if $(and $(SHARDS),$(call asks,dataset evaluate export feats-export pareto-models train ship)),$(if $(IMPORTED)$(IMAGES),,$(error \
    $(DATA)/log.csv: names no images, or [params.poses] images = false: run make labels calibrate DATASET=$(DATASET), or write each \
    press' image into the column image)))
$(if $(and $(IMPORTED),$(NEEDS_PLAN)),$(foreach r,$(RES),$(if $(wildcard $(DATA)/labels/$r.npz),,$(error $(DATA) was imported with labels of \
    $(notdir $(basename $(wildcard $(DATA)/labels/*.npz))), not of $r: say RES=$(firstword $(notdir $(basename $(wildcard $(DATA)/labels/*.npz))))))))
$(if $(and $(filter $(NEED_NOCONTACT) shipped,$(value MODEL)),$(call asks,evaluate report train ship)),$(if $(wildcard \
    $(DATA)/nocontact),,$(error MODEL=$(value MODEL) reads a picture beside a no-contact image, and $(DATA)/nocontact is missing: add \
    nocontact/SENSOR.png of each sensor, or name a network that reads the image alone, such as unet)))

# Status makes nothing: without targets for the shards make starts in half the time.
ifeq ($(MAKECMDGOALS),status)
SHARDS :=
endif
