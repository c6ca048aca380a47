# Branch stability: where each fidelity converges, fails and drifts. One target per factor; solved cases are kept, so
# that a row that is cut short resumes.
STABILITY_ROWS := depth shear place nu size steps random native
STABILITY_FILES := $(STABILITY_ROWS:%=$D/stability/rows/%.json)

.PHONY: stability
stability: $D/stability/map.json  ## where the mechanics converge, fail and drift: map, CSV, JSON (hours; resumes)

$(STABILITY_FILES): $D/stability/rows/%.json: $P/stability.json $(filter $D/pareto/meshes/ccx-%,$(PARETO_MESH_FILES))
	$(call step,gelforge.stages.stability row --row $* --params $< --meshes $D/pareto/meshes --cases $D/stability/cases --out $@.part)

$D/stability/map.json: $(STABILITY_FILES)
	$(call step,gelforge.stages.stability map --rows $^ --out $@.part)
