# Stage 20: tetrahedral gel meshes, one per region and density, never one per sample. Bricks need no file.
MESH_FILES := $(MESHES:%=$D/20_meshes/%.npz)

.PHONY: meshes
meshes: $(MESH_FILES) $(call barrier,20_meshes)  ## gel meshes of the chosen fidelity, with quality reports

$(MESH_FILES): $D/20_meshes/%.npz: $P/meshes.json
	$(call step,gelforge.stages.meshes --name $* --params $< --out $@.part)
