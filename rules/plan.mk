# Stage 00: shards and lists of names, which make must know before it reads the rules of the stages.
D := results/$(DATASET)
P := $D/00_plan/params
SHARD := $D/00_plan/shards
BESIDE := $D/00_plan/beside
CHOICE := $D/00_plan/choices
DATA := data/$(DATASET)
IMPORTED := $(wildcard $(DATA)/labels)
PLANNED := $D/00_plan/plan.mk

# The network that the report shows, the one that `make train` makes, and results of branches that the report shows.
MODEL := $(call answered,MODEL)
LEARNT := $(call answered,LEARNT)
SHOWN := $(addprefix $D/,$(call answered,SHOWN))

# The frozen calibration that labels use, if there is one: a small file that only `make freeze` changes.
IS_FROZEN := $(wildcard $(DATA)/calibration.toml)

# The plan's lists, empty if no plan is read.
LISTS := SHARDS BRANCHES PARETO_SCENES MODELS TUNED CALIBRATED LEARN_ALSO IMAGES GELS MESHED_GELS CHARTED_GELS
$(foreach v,$(LISTS),$(eval $v :=))

# refuse.py removes an outdated plan; make then makes this included file again and restarts itself.
include $(if $(filter plan,$(ANSWER)),$(PLANNED))

$(PLANNED): | $(SETUP) $(CCX_FOUND)
	@$(PY) -m gelforge.stages.plan $D --ccx $(CCX_FOUND)

# Status makes nothing: without targets for the shards make starts in half the time.
ifeq ($(MAKECMDGOALS),status)
SHARDS :=
endif
