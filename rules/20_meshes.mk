# Stage 20: the tetrahedral gel mesh of each press, one per region and density, made when a press needs it. Hexahedra
# need no file. The usual gel's meshes ship; what is made here is kept in workflow/meshes.
MESH_TABLES := $(if $(MESHES),$(SHARDS:%=$D/20_meshes/%.csv))

meshes: $(MESH_TABLES) $(call barrier,20_meshes)  ## make the gel meshes that the presses need, with quality reports

$(MESH_TABLES): $D/20_meshes/%.csv: $D/10_poses/%.csv $P/meshes.json $P/fea.json $P/gels.json | $(call barrier,10_poses)
	$(HANDS_SLOTS)$(call step,gelforge.stages.meshes $D $* $(IN_SLOTS))
