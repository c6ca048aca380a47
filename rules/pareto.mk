# Branch pareto: seconds against error of every solver, mesh density and load-step count, on the scenes of
# workflow/scenes.toml. A full chart is hours of solves; a scene that is cut short resumes at its next method.
# References are kept in data/, because they are hours of solves; one whose scene or settings changed is solved anew.
KEPT_REFERENCES := $(wildcard data/fea_challenge/keys.json)
PARETO_MESH_FILES := $(PARETO_MESHES:%=$D/pareto/meshes/%.npz)
PARETO_FILES := $(PARETO_SCENES:%=$D/pareto/scenes/%.json)
SCENE_READS := $P/sensors.json $(KEPT_REFERENCES)

pareto: $D/pareto/pareto.json  ## speed against accuracy of the mechanics: chart, CSV, JSON (hours; resumes)

$(PARETO_MESH_FILES): $D/pareto/meshes/%.npz: $P/meshes.json $P/gels.json
	$(call step,gelforge.stages.pareto mesh $D $*)

$(PARETO_FILES): $D/pareto/scenes/%.json: $P/pareto.json $P/scenes/%.json $(SCENE_READS) $(PARETO_MESH_FILES)
	$(call step,gelforge.stages.pareto scene $D $*)

$D/pareto/pareto.json: $(PARETO_FILES)
	$(call step,gelforge.stages.pareto chart $D)

# It refuses references whose keys are of other methods or of another version of the chart.
fea-challenge: $(SETUP)  ## write the scenes as an open benchmark for simulators: results/fea_challenge
	@$(PY) -m gelforge.stages.challenge write results/fea_challenge

fea-references: $(PARETO_FILES)  ## make the references of fea-challenge again from the large chart (hours)
	@$(PY) -m gelforge.stages.challenge references $D
