# Stage 00: shards and parameter slices, made while make reads its files, so that `make -n` is exact.
D := results/$(DATASET)
P := $D/00_plan/params
DATA := data/$(DATASET)
PLAN := $D/00_plan/plan.mk

# Goals that need no dataset do not read one.
NO_DATASET := help setup lint format test test-% rig rig-% benchmark-% lock clean-venv feats-import mcap-import projection
ifneq ($(filter-out $(NO_DATASET),$(or $(MAKECMDGOALS),help)),)
include $(PLAN)
else
SHARDS :=
MESHES :=
BRANCHES :=
REPORT_MODEL :=
endif

$(PLAN): $(DATA)/log.csv $(DATA)/dataset.toml $(wildcard workflow/*.toml) $(wildcard src/gelforge/*/*.py) $(CCX_FOUND) | $(SETUP)
	@$(PY) -m gelforge.stages.plan --data $(DATA) --ccx "$$(cat $(CCX_FOUND))" --out $@

$(DATA)/log.csv $(DATA)/dataset.toml:
	$(error $@ not found: DATASET=$(DATASET) needs a raw log and a dataset.toml; see README.md, or write one with make rig)

# $(call step,MODULE ARGUMENTS) is the recipe of every artifact: it writes $@.part, the wrapper publishes it.
# Of more inputs than a shell takes as one command (128 KiB) none is named; their reader refuses a broken one.
wrapped = $(PY) -m gelforge.flow.step $@ $(if $(word 1500,$^),,$(filter $D/%,$^)) -- $(PY) -m $(1)
ifeq ($(EXECUTOR),local)
step = @$(wrapped)
barrier =
else ifeq ($(EXECUTOR),slurm)
include rules/00_slurm.mk
else
$(error EXECUTOR=$(EXECUTOR): local or slurm is needed)
endif
