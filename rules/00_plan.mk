# Stage 00: shards and stage parameters, so that `make -n` is exact. At each make flow/asked.py judges what is given,
# sees by the state of all files that the plan was made from whether they must be planned anew, and names results that
# are due whatever their dates.
D := results/$(DATASET)
P := $D/00_plan/params
DATA := data/$(DATASET)
IMPORTED := $(wildcard $(DATA)/labels)
PLANNED := $D/00_plan/plan.mk

# Before set-up there is no environment: names are judged by any Python.
ASK := $(if $(wildcard $(PY)),PYTHONPATH=src $(PY) -P -S -m gelforge.flow.asked,python3 src/gelforge/flow/given.py)
ANSWER := $(shell $(ASK) $(call if_given,SENSOR MODEL FORMAT EXECUTOR JOBS CHARTED TESTS ID) \
    $(foreach v,DATASET RES MAKE_RESTARTS,$v=$(call given,$v)) GOALS=$(call given,MAKECMDGOALS))
$(if $(filter-out 0,$(.SHELLSTATUS)),$(error $(or $(ANSWER),Python 3.11 or newer is needed as python3)))
DUE := $(filter $D/%,$(ANSWER))
MODEL ?= $(patsubst MODEL=%,%,$(filter MODEL=%,$(ANSWER)))
# The network that `make train` makes: the shipped one is never trained here.
LEARNT := $(patsubst LEARNT=%,%,$(filter LEARNT=%,$(ANSWER)))

# What labels are made with, once a calibration was frozen: a small file that only `make freeze` changes.
IS_FROZEN := $(wildcard $(DATA)/calibration.toml)

# The plan's lists, empty where none is read.
LISTS := SHARDS MESHES BRANCHES PARETO_SCENES PARETO_QUICK PARETO_MESHES MODELS TUNED CALIBRATED LEARN_ALSO IMAGES
$(foreach v,$(LISTS),$(eval $v :=))

include $(if $(filter plan,$(ANSWER)),$(PLANNED))
# Status makes nothing: without the shards' targets make starts in half the time.
ifeq ($(MAKECMDGOALS),status)
SHARDS :=
endif

.PHONY: again due
$(PLANNED): $(filter again,$(ANSWER)) | $(SETUP) $(CCX_FOUND)
	@$(PY) -m gelforge.stages.plan $D --ccx $(CCX_FOUND)

# $(call step,MODULE WORDS) is the recipe of every artifact: it writes $@.part, the wrapper publishes it.
# Of more inputs than a shell takes as one command (128 KiB) those of the shards are left out. What a network learns
# from or is fine-tuned from beside its dataset lies elsewhere.
LISTED = $(if $(word 1500,$^),$(filter-out $(POSES) $(FORCES),$^),$^)
READS = $(filter $D/% $(LEARNT_WITH) $(SHIPPED).onnx $(SHIPPED).safetensors,$(LISTED))
wrapped = $(PY) -m gelforge.flow.step $@ $(READS) -- $(PY) -m $(strip $(1)) --part
IN_SLOTS = $(if $(filter local,$(EXECUTOR)),--jobs $(SLOTS))
ifeq ($(EXECUTOR),local)
step = @$(wrapped)
barrier =
else
include rules/00_slurm.mk
endif

clean-ahead:  ## remove results dated ahead of this machine's clock, so that make makes them again; keeps solved presses
	@$(PY) -m gelforge.flow.dates $D
