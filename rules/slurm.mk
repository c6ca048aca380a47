# What each barrier of EXECUTOR=slurm waits for, before the stages that read it go on.
.PHONY: slurm-cancel
slurm-cancel:  ## cancel what was left running on Slurm (DETACH=1)
	@$(PY) -m gelforge.slurm cancel --results $D

ifeq ($(EXECUTOR),slurm)
ifneq ($(COLLECT),)
BARRIERS := $(COLLECT:%=barrier-%)
.PHONY: $(BARRIERS)
barrier-10_poses: $(POSES)
barrier-20_meshes: $(MESH_FILES)
barrier-30_fea: $(FEA)
barrier-40_forces: $(FORCES)

$(BARRIERS): barrier-%:
	@$(if $(filter $*,$(COLLECTED)),$(call SLURM_RUN,flush) --stage $*)
endif
endif
