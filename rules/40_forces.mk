# Stage 40: nodal contact forces, checked for equilibrium.
FORCES := $(SHARDS:%=$D/40_forces/%.npz)

# [material] c10 = "calibrated" waits for the posterior and scales by its median; no solve is repeated.
CALIBRATED := $(if $(NEEDS_CALIBRATION),$D/calibrate/summary.json)

.PHONY: forces
forces: $(FORCES) $(call barrier,40_forces)  ## nodal contact forces from the solvers' output

forces_of = gelforge.stages.forces --fea $1/30_fea/$2.csv --meshes $D/20_meshes --params $P/forces.json \
    $(if $(CALIBRATED),--calibration $(CALIBRATED)) --out $1/40_forces/$2.npz

$(FORCES): $D/40_forces/%.npz: $D/30_fea/%.csv $P/forces.json $(CALIBRATED) | $(call barrier,30_fea)
	$(call step,$(call forces_of,$D,$*).part)
