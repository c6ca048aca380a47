FORCES := $(SHARDS:%=$D/40_forces/%.npz)

forces: $(FORCES) $(call barrier,40_forces)  ## nodal contact forces from the solvers' output, checked for equilibrium

# CALIBRATED is the posterior where [material] c10 = "calibrated": its median scales the forces, no solve is repeated.
$(FORCES): $D/40_forces/%.npz: $D/30_fea/%.csv $P/forces.json $(CALIBRATED:%=$D/%) | $(call barrier,30_fea)
	$(call step,gelforge.stages.forces $D $*)
