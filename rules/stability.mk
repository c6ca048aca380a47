# Branch stability: where each fidelity converges, fails and drifts. One target per factor; solved cases are kept, so
# that a row that is cut short resumes.
STABILITY_ROWS := depth shear place tilt ridge nu friction size steps random native
STABILITY_FILES := $(STABILITY_ROWS:%=$D/stability/rows/%.json)

.PHONY: stability
stability: $D/stability/map.json  ## parameters at which the mechanics converge, fail or lose accuracy: map, CSV, JSON (hours; resumes)

# Rows at label setting take meshes that ship; the others those of the chart.
$(filter %/size.json %/steps.json %/native.json,$(STABILITY_FILES)): $(filter $D/pareto/meshes/ccx-%,$(PARETO_MESH_FILES))

$(STABILITY_FILES): $D/stability/rows/%.json: $P/stability.json
	$(call step,gelforge.stages.stability row --row $* --params $< --meshes $D/pareto/meshes --cases $D/stability/cases --out $@.part)

$D/stability/map.json: $(STABILITY_FILES)
	$(call step,gelforge.stages.stability map --rows $^ --out $@.part)
