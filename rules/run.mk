# How results are made. One recipe makes every file of results/DATASET: the wrapper (flow/step.py) finds by the file's name
# which stage writes it (flow/layout.py), lets it write $@.part, and renames that. If the stage's command and the contents of
# all prerequisites match the record, the wrapper only touches the target; else it says what changed.

# Jobs default to the cores of the machine; -jN on the command line takes precedence.
ifeq ($(filter -j%,$(MAKEFLAGS)),)
MAKEFLAGS += -j$(JOBS)
endif
# Job slots for a program that runs several jobs itself. Only known when a recipe is expanded.
SLOTS = $(or $(patsubst -j%,%,$(filter -j%,$(MAKEFLAGS))),$(JOBS))
export GELFORGE_JOBS = $(SLOTS)

# EXECUTOR=slurm: solves and trainings run as jobs of a cluster; make waits for each, so give it as many jobs as the
# cluster shall run at once: make -j200 fea EXECUTOR=slurm. The launcher stands in front of the command (flow/slurm.py).
LAUNCHED :=
ifeq ($(EXECUTOR),slurm)
$D/30_fea/% $D/70_train/%: LAUNCHED := GELFORGE_LAUNCHER='$(PY) -m gelforge.flow.slurm --profile $(or $(value SLURM_PROFILE),workflow/slurm.toml)'
endif

# Every prerequisite is an input; if they exceed what a shell takes as one command (128 KiB), they are passed as a
# list file.
LIST = $D/00_plan/$(subst /,-,$@).inputs
INPUTS = $(if $(word 500,$^),@$(LIST)$(shell mkdir -p $D/00_plan)$(file >$(LIST),$^),$^)

# With + a stage may take free slots of make (flow/jobs.py); but make runs such a recipe even with -n, -q and -t.
STEP = $(if $(ONLY_SHOWN),,+)@$(LAUNCHED) $(PY) -m gelforge.flow.step $@ $(INPUTS)
$D/%:
	$(STEP)
