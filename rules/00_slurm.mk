# EXECUTOR=slurm: the recipe of an artifact only notes its task; a barrier per stage runs what was noted as a job array.
SLURM_PROFILE ?= workflow/slurm.toml

# Stages of many files. The artifacts of all others, and files asked for by name, are jobs of their own.
COLLECT := $(if $(filter $D/%,$(MAKECMDGOALS)),,10_poses 20_meshes 30_fea 40_forces)
# Of these stages, those with a note.
NOTED :=

SLURM_STAGE = $(firstword $(subst /, ,$(@:$D/%=%)))
# Notes are named by make's process as well, because another make may be at work.
SLURM_NOTES = $(eval SLURM_NOTES := $$(shell mkdir -p $D/.slurm && echo $D/.slurm/$$$$PPID))$(SLURM_NOTES)
slurm = $(PY) -m gelforge.flow.slurm $(SLURM_NOTES)-$(1) --profile $(call given,SLURM_PROFILE)

SLURM_ALONE = $(subst /,-,$@)
# Under -n, -q and -t nothing is noted or submitted: `make -n` prints the same steps as on one machine.
step = @$(if $(ONLY_SHOWN)$(filter-out $D/%,$@),$(wrapped),$(if $(filter $(SLURM_STAGE),$(COLLECT)),$(noted),$(alone)))
alone = $(shell rm -f $@)$(file >$(SLURM_NOTES)-$(SLURM_ALONE),$@	$(wrapped))$(call slurm,$(SLURM_ALONE))
# The first note of a stage replaces what a killed make left. An outdated target goes: make must see that it changes.
noted = $(file $(if $(filter $(SLURM_STAGE),$(NOTED)),>)>$(SLURM_NOTES)-$(SLURM_STAGE),$@	$(wrapped))$(is_noted)
is_noted = $(eval NOTED := $(sort $(NOTED) $(SLURM_STAGE)))$(if $(wildcard $@),rm -f $@)

# $(call barrier,STAGE…) as an order-only prerequisite: wait until those stages' tasks have run. What a barrier waits
# for is known once the stages' rules are read, hence the second expansion.
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
	@$(if $(filter $*,$(NOTED)),$(call slurm,$*))
endif
