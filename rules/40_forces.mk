# Stage 40: nodal contact forces, checked for equilibrium.
FORCES := $(SHARDS:%=$D/40_forces/%.npz)

.PHONY: forces
forces: $(FORCES) $(call barrier,40_forces)  ## nodal contact forces out of the solvers' output

$(FORCES): $D/40_forces/%.npz: $D/30_fea/%.csv $P/forces.json | $(call barrier,30_fea)
	$(call step,gelforge.forces --fea $< --meshes $D/20_meshes --params $P/forces.json --out $@.part)
