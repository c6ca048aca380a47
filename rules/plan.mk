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
$(if $(wildcard $(DATA)/log.csv),,$(error $(DATA)/log.csv not found: DATASET=$(DATASET) needs a raw log and a dataset.toml, which \
    workflow/guide/your-data.md describes; make rig writes simulated ones))
# -n, -q and -t run nothing, and so no set-up: without it, or without a plan, make cannot know what it would do.
$(if $(ONLY_SHOWN),$(if $(and $(wildcard $(SETUP)),$(wildcard $(CCX_FOUND))),,$(error not set up yet: run make setup; -n and -q install nothing)))
include $(PLANNED)
endif

# Folders are prerequisites, because a file that is removed has no date. Twice, because words of a name with blanks are
# no files.
PLAN_INPUTS := $(wildcard $(wildcard $(DATA) $(DATA)/log.csv $(DATA)/*.toml $(DATA)/nocontact $(DATA)/nocontact/* $(DATA)/labels $(DATA)/labels/*.npz \
    $(DATA)/splits.csv $(DATA)/truth $(DATA)/truth/*.csv workflow/*.toml src/gelforge/stages/*.py src/gelforge/flow/*.py)) $(PLANNED_FROM)

$(PLANNED): $(PLAN_INPUTS) $(wildcard $(CCX_FOUND)) | $(SETUP) $(CCX_FOUND)
	$(call step,gelforge.stages.plan $D --ccx $(CCX_FOUND))

# A file of the plan that was removed is written again, and those of networks and scenes for the first goal that needs
# them: the plan writes them where their folder exists.
$D/00_plan/%: | $(PLANNED)
	@test -e $@ || { mkdir -p $(@D); $(PY) -m gelforge.stages.plan $D --ccx $(CCX_FOUND) >/dev/null; }

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
# What goals need, checked before anything is made. A check by an outdated plan may be wrong: then the plan is made
# again first, and make has read its rules anew.
UNSURE :=
$(if $(call asks,export),$(if $(filter mcap lerobot hdf5,$(value FORMAT)),,$(error FORMAT=$(value FORMAT): name one of mcap lerobot hdf5)))
complain = $(if $(value MAKE_RESTARTS),$(error $1),$(eval UNSURE := yes))
NEEDED := $(sort $(if $(call asks,evaluate report demo),$(NET)) $(if $(TRAINS),$(LEARNT)) $(if $(call asks,pareto-models),$(LEARNABLE)))
$(if $(filter-out $(MODELS) shipped,$(NET)),$(call complain,MODEL=$(NET): no such network; workflow/models.toml has: $(MODELS)$(comma) \
    and shipped is the one that ships))
$(if $(and $(filter shipped,$(value MODEL)),$(TRAINS)),$(call complain,MODEL=shipped: the shipped network was trained elsewhere; to \
    $(firstword $(TRAINS))$(comma) name one of $(MODELS)))
$(if $(and $(filter $(TUNED),$(value MODEL)),$(filter-out $(SHIPPED_RES),$(RES1))),$(call complain,MODEL=$(value MODEL) fine-tunes the \
    shipped network$(comma) whose grid is $(SHIPPED_RES): say RES=$(SHIPPED_RES)$(comma) or name another network))
$(if $(call asks,ship),$(if $(value MODEL),,$(call complain,ship: replaces the shipped network; name the new one: make ship MODEL=… \
    DATASET=…)))
$(if $(and $(call asks,ship),$(filter-out $(SHIPPED_RES),$(RES1))),$(call complain,ship RES=$(RES1): the shipped network has a grid of \
    $(SHIPPED_RES); train a network with that grid: RES=$(SHIPPED_RES)))
$(if $(and $(SHARDS),$(call asks,dataset evaluate export feats-export pareto-models train ship)),$(if $(IMPORTED)$(IMAGES),,$(call \
    complain,$(DATA)/log.csv: names no images$(comma) or [params.poses] images = false$(comma) so that its flow ends at labels and \
    calibrate: run make report DATASET=$(DATASET)$(comma) or write the image of each press into the column image)))
CAME := $(notdir $(basename $(wildcard $(DATA)/labels/*.npz)))
$(if $(and $(IMPORTED),$(NEEDS_PLAN)),$(foreach r,$(filter-out $(CAME),$(RES)),$(call complain,$(DATA) was imported with labels of \
    $(CAME)$(comma) not of $r: say RES=$(firstword $(CAME)))))
$(if $(filter $(NEED_NOCONTACT) shipped,$(NEEDED)),$(if $(wildcard $(DATA)/nocontact),,$(if $(IMPORTED)$(IMAGES),$(call complain,MODEL=$(firstword \
    $(filter $(NEED_NOCONTACT) shipped,$(NEEDED))) reads a picture beside a no-contact image$(comma) and $(DATA)/nocontact is missing: \
    add nocontact/SENSOR.png of each sensor$(comma) or name a network that reads the image alone$(comma) such as unet ([params.report] \
    model in $(DATA)/dataset.toml)))))
# Other datasets to train on as well ([train] also). Each is made by its own run of make.
LEARNT_WITH := $(foreach name,$(LEARN_ALSO),results/$(name)/60_dataset/$(if $(wildcard data/$(name)/labels/1x1.npz),1x1,$(RES1))/dataset.json)
$(foreach file,$(filter-out $(wildcard $(LEARNT_WITH)),$(LEARNT_WITH)),$(if $(filter-out shipped,$(NEEDED)),$(call complain,$(file) is \
    missing$(comma) and [train] also asks for it: make DATASET=$(word 2,$(subst /, ,$(file))) RES=$(word 4,$(subst /, ,$(file))) dataset)))
ifneq ($(UNSURE),)
.PHONY: unsure
$(PLANNED): unsure
endif

# Status makes nothing: without targets for the shards make starts in half the time.
ifeq ($(MAKECMDGOALS),status)
SHARDS :=
endif
