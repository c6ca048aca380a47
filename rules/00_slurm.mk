# EXECUTOR=slurm: the recipe of an artifact only notes its task; a barrier per stage runs what was noted as job arrays.
DETACH ?=
override DETACH := $(filter-out $(NO),$(DETACH))
SLURM_PROFILE ?= workflow/slurm.toml
SLURM_RUN = $(PY) -m gelforge.flow.slurm.run $(1) --results $D --profile $(call given,SLURM_PROFILE)$(if $(DETACH), --detach)

# Stages of many files. The artifacts of all others, and files asked for by name, are jobs of their own.
COLLECT := $(if $(filter $D/%,$(MAKECMDGOALS)),,10_poses 20_meshes 30_fea 40_forces)
COLLECTED :=

# Under -n, -q and -t nothing is noted or submitted: `make -n` prints what would run.
SLURM_DRY = $(strip $(foreach f,n q t,$(findstring $f,$(firstword -$(MAKEFLAGS)))))
SLURM_STAGE = $(firstword $(subst /, ,$(@:$D/%=%)))

step = @$(if $(filter $D/%,$@),$(if $(filter $(SLURM_STAGE),$(COLLECT)),$(noted),$(alone)),$(wrapped))
alone = $(if $(SLURM_DRY),$(wrapped),$(call SLURM_RUN,run) --target $@ -- $(wrapped))
# An outdated target goes now: make must see that it changes, and its presence later proves that the task was done.
noted = $(eval COLLECTED := $(sort $(COLLECTED) $(SLURM_STAGE)))$(if $(SLURM_DRY),$(wrapped),$(note)$(if $(wildcard $@),rm -f $@))
note = $(file >>$D/.slurm/$(SLURM_STAGE).tasks,$@	$(wrapped))

# $(call barrier,STAGE…) as an order-only prerequisite: wait until those stages' tasks have run. What a barrier waits for
# is known once the stages' rules are read, hence the second expansion.
barrier = $(addprefix barrier-,$(filter $(1),$(COLLECT)))
BARRIERS := $(COLLECT:%=barrier-%)
.PHONY: $(BARRIERS)
.SECONDEXPANSION:
ifneq ($(BARRIERS),)
barrier-10_poses: $$(POSES)
barrier-20_meshes: $$(MESH_TABLES)
barrier-30_fea: $$(FEA)
barrier-40_forces: $$(FORCES)
$(BARRIERS): barrier-%:
	@$(if $(filter $*,$(COLLECTED)),$(call SLURM_RUN,flush) --stage $*)
endif

# One make at a time, after what an earlier one left running: held until this make ends.
ifeq ($(or $(SLURM_DRY),$(if $(wildcard $(SETUP)),,bare)),)
ifneq ($(filter-out $(NO_DATASET) status sample clean-% slurm-% $(if $(IS_FROZEN),,demo calibrated-labels),$(or $(MAKECMDGOALS),help)),)
$(shell $(call SLURM_RUN,attend) --make $$PPID)
ifneq ($(.SHELLSTATUS),0)
$(error what was left running on Slurm was not finished; see above)
endif
endif
endif
