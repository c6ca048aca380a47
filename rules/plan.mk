# Stage 00: what make must know before it reads the rules of the stages: the shards, and lists of names.
D := results/$(DATASET)
P := $D/00_plan/params
SHARD := $D/00_plan/shards
BESIDE := $D/00_plan/beside
CHOICE := $D/00_plan/choices
DATA := data/$(DATASET)
IMPORTED := $(wildcard $(DATA)/labels)
PLANNED := $D/00_plan/plan.mk

# The network that the report shows, the one that `make train` makes, and what the report shows of branches.
MODEL := $(call answered,MODEL)
LEARNT := $(call answered,LEARNT)
SHOWN := $(addprefix $D/,$(call answered,SHOWN))

# What labels are made with, once a calibration was frozen: a small file that only `make freeze` changes.
IS_FROZEN := $(wildcard $(DATA)/calibration.toml)

# The plan's lists, empty where none is read.
LISTS := SHARDS BRANCHES PARETO_SCENES MODELS TUNED CALIBRATED LEARN_ALSO IMAGES
$(foreach v,$(LISTS),$(eval $v :=))

# refuse.py removes a plan whose files have another content now; make makes what it includes, and starts again.
include $(if $(filter plan,$(ANSWER)),$(PLANNED))

$(PLANNED): | $(SETUP) $(CCX_FOUND)
	@$(PY) -m gelforge.stages.plan $D --ccx $(CCX_FOUND)

# Status makes nothing: without the shards' targets make starts in half the time.
ifeq ($(MAKECMDGOALS),status)
SHARDS :=
endif
