# One target per factor; solved cases are kept, so that a row that is cut short resumes.
STABILITY_ROWS := depth shear place tilt ridge nu friction size steps random
STABILITY_FILES := $(STABILITY_ROWS:%=$D/stability/rows/%.json)

stability: $D/stability/map.json  ## where the mechanics converge, fail or lose accuracy: map, CSV (hours; resumes)

# Rows at label setting take meshes that ship; the others those of the chart.
$(addprefix $D/stability/rows/,size.json steps.json): $(filter $D/pareto/meshes/ccx-%,$(PARETO_MESH_FILES))

$(STABILITY_FILES): $D/stability/rows/%.json: $P/stability.json
	$(call step,gelforge.stages.stability row $D $*)

$D/stability/map.json: $(STABILITY_FILES)
	$(call step,gelforge.stages.stability map $D)
