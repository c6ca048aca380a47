# EXECUTOR=slurm: what each barrier waits for; its tests on a real one-machine cluster.
SLURM_FOUND := .venv/slurm.found

# After CalculiX: two installs at once would fight for apt's lock.
$(SLURM_FOUND): envs/slurm.sh | $(SETUP) $(CCX_FOUND)
	@envs/slurm.sh $@

test: $(SLURM_FOUND)

.PHONY: test-slurm slurm-cancel
test-slurm: $(SETUP) $(SLURM_FOUND)  ## tests of EXECUTOR=slurm on a real cluster of one node, started and stopped here
	@$(PY) -m pytest tests/workflow/test_slurm.py tests/workflow/test_slurm_parts.py

benchmark-slurm: $(SLURM_FOUND)

slurm-cancel:  ## cancel what was left running on Slurm (DETACH=1)
	@$(PY) -m gelforge.flow.slurm.run cancel --results $D

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
