# Stage 40: nodal contact forces, checked for equilibrium.
FORCES := $(SHARDS:%=$D/40_forces/%.npz)

# [material] c10 = "calibrated" waits for the posterior and scales by its median; no solve is repeated.
CALIBRATED := $(if $(NEEDS_CALIBRATION),$D/calibrate/summary.json)

.PHONY: forces
forces: $(FORCES) $(call barrier,40_forces)  ## nodal contact forces from the solvers' output

$(FORCES): $D/40_forces/%.npz: $D/30_fea/%.csv $P/forces.json $(CALIBRATED) | $(call barrier,30_fea)
	$(call step,gelforge.stages.forces --fea $< --meshes $D/20_meshes --params $P/forces.json $(if $(CALIBRATED),--calibration $(CALIBRATED)) --out $@.part)
