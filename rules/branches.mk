# Branches: calibrate, pareto, stability, the chart of networks, and shipping a network.
.PHONY: calibrate freeze pareto fea-challenge fea-references stability pareto-models ship

# Posterior of C10 and of the bench's errors, from the forces and the commanded paths of the log's rows. Pictures are
# drawn beside the stages that follow it. A log that gives no posterior gives a summary that says
# why: the report shows it, `make calibrate` fails with it.
POSTERIOR := $D/calibrate/summary.json
PLOTS := $D/calibrate/plots.json
calibrate: $(POSTERIOR) $(PLOTS)  ## posterior of C10, touch offset, compliance and friction from the log's force readings
	@$(PY) -m gelforge.commands.freeze show $D
freeze: $(POSTERIOR)  ## write the posterior to data/DATASET/calibration.toml: labels follow it until the next make freeze
	@$(PY) -m gelforge.commands.freeze keep $D
$(POSTERIOR): $(ROWS) $P/calibrate.json $P/indenters.json $P/sensors.json $P/gels.json | $(IMAGES_JUDGED)
$(PLOTS): $(POSTERIOR) $P/plots.json

# Seconds against error of every solver, mesh density and number of load steps, on the scenes of workflow/scenes.toml:
# half an hour. An interrupted scene resumes at its next method. References are kept in data/ and solved again if scene or
# settings change.
PARETO_FILES := $(PARETO_SCENES:%=$D/pareto/scenes/%.json)
pareto: $D/pareto/pareto.json  ## speed against accuracy of the mechanics: chart, CSV, JSON (half an hour; resumes)
$(PARETO_FILES): $D/pareto/scenes/%.json: $P/pareto.json $P/scenes/%.json $P/chart.json $P/gels.json $(CHARTED_GELS:%=$D/20_meshes/%.npz) \
    $(wildcard data/fea_challenge/keys.json)
$D/pareto/pareto.json: $(PARETO_FILES) $P/pareto.json $P/scenes.json

# It refuses references whose keys belong to other methods or to another version of the chart.
fea-challenge: $(SETUP)  ## write the scenes as an open benchmark for simulators: results/fea_challenge
	@$(PY) -m gelforge.stages.challenge write results/fea_challenge
fea-references: $(PARETO_FILES)  ## recompute the references of fea-challenge from the large chart (hours)
	@$(PY) -m gelforge.stages.challenge references $D

# Where the mechanics converge: one target per factor; solved cases are kept, so that an interrupted row resumes.
STABILITY_FILES := $(patsubst %,$D/stability/rows/%.json,depth shear place tilt ridge nu friction size steps random)
stability: $D/stability/map.json  ## where the mechanics converge, fail or lose accuracy: map, CSV (an hour or two; resumes)
$(STABILITY_FILES): $P/stability.json $P/gels.json $(CHARTED_GELS:%=$(MESH))
$D/stability/map.json: $(STABILITY_FILES)

# All networks but those fine-tuned from the shipped one. The plan's list is a prerequisite: a removed one has no date.
pareto-models: possible $D/pareto_models/$(RES1).json  ## accuracy against latency of every network: chart, CSV, JSON
$D/pareto_models/$(RES1).json: $P/networks.json $P/pareto_models.json $D/60_dataset/$(RES1)/dataset.json \
    $(LEARNABLE:%=$D/80_evaluate/$(RES1)/%.json) $(LEARNABLE:%=$D/70_train/$(RES1)/%.onnx)

# The last line sets the date of the shipped file on its sources: a network that was fine-tuned from the replaced one
# is then not outdated. Results of benchmark-unseen and benchmark-real for this network go into the card.
MEASURED := $(wildcard results/benchmarks/unseen.json results/benchmarks/real.json)
NEW := $D/70_train/$(RES1)/$(LEARNT).onnx $D/80_evaluate/$(RES1)/$(LEARNT).json
ship: possible $(NEW)  ## replace the shipped network by a trained one: make ship MODEL=… DATASET=…
	@$(PY) -m gelforge.stages.card $D $(RES1) $(LEARNT) --part --measured $(MEASURED) --ship $(SHIPPED).onnx.part
	cp $D/70_train/$(RES1)/$(LEARNT).safetensors $(SHIPPED).safetensors
	mv $(SHIPPED).onnx.part $(SHIPPED).onnx
	mv $D/80_evaluate/$(RES1)/$(LEARNT).card.md.part $(SHIPPED).md
	touch -r $(SHIPPED).onnx $(NEW) $(SHIPPED).safetensors
