# Branches: calibrate, pareto, stability, the chart of networks, and shipping a network.

# Posterior of C10 and of the bench's errors, from the forces and the commanded paths of the log's rows. Pictures are
# drawn beside the stages that follow it. A log that gives no posterior gives a summary that says
# why: the report shows it, `make calibrate` fails with it.
POSTERIOR := $D/calibrate/summary.json
PLOTS := $D/calibrate/plots.json

.PHONY: calibrate
calibrate: $(POSTERIOR) $(PLOTS)  ## posterior of C10, touch offset, compliance and friction from the log's force readings
	@$(PY) -m gelforge.commands.freeze --show $D

$(POSTERIOR): $(SHARDS:%=$(SHARD)/%.csv) $P/calibrate.json $P/indenters.json $P/sensors.json $P/gels.json | $(IMAGES_JUDGED)
	$(HANDS_SLOTS)$(call step,gelforge.stages.calibrate $D)

$(PLOTS): $(POSTERIOR) $P/plots.json
	$(call step,gelforge.stages.plots $D)

.PHONY: freeze
freeze: $(POSTERIOR)  ## write the posterior to data/DATASET/calibration.toml: labels follow it until the next make freeze
	@$(PY) -m gelforge.commands.freeze $D

.PHONY: demo
demo: report  ## the whole flow on the demo dataset, from its log to a report
	@echo "open $(REPORT) in a browser: presses, labels, the posterior, networks, and what failed"

# Seconds against error of every solver, mesh density and number of load steps, on the scenes of workflow/scenes.toml:
# half an hour. An interrupted scene resumes at its next method. References are kept in data/ and solved again if scene or
# settings change.
KEPT_REFERENCES := $(wildcard data/fea_challenge/keys.json)
PARETO_FILES := $(PARETO_SCENES:%=$D/pareto/scenes/%.json)

.PHONY: pareto
pareto: $D/pareto/pareto.json  ## speed against accuracy of the mechanics: chart, CSV, JSON (half an hour; resumes)

$(PARETO_FILES): $D/pareto/scenes/%.json: $P/pareto.json $P/scenes/%.json $P/chart.json $P/gels.json $(CHARTED_GELS:%=$(MESH)) $(KEPT_REFERENCES)
	$(call step,gelforge.stages.pareto scene $D $*)

$D/pareto/pareto.json: $(PARETO_FILES) $P/pareto.json $P/scenes.json
	$(call step,gelforge.stages.pareto chart $D)

# It refuses references whose keys belong to other methods or to another version of the chart.
.PHONY: fea-challenge
fea-challenge: $(SETUP)  ## write the scenes as an open benchmark for simulators: results/fea_challenge
	@$(PY) -m gelforge.stages.challenge write results/fea_challenge

.PHONY: fea-references
fea-references: $(PARETO_FILES)  ## recompute the references of fea-challenge from the large chart (hours)
	@$(PY) -m gelforge.stages.challenge references $D

# Where the mechanics converge: one target per factor; solved cases are kept, so that an interrupted row resumes.
STABILITY_ROWS := depth shear place tilt ridge nu friction size steps random
STABILITY_FILES := $(STABILITY_ROWS:%=$D/stability/rows/%.json)

.PHONY: stability
stability: $D/stability/map.json  ## where the mechanics converge, fail or lose accuracy: map, CSV (an hour or two; resumes)

$(STABILITY_FILES): $D/stability/rows/%.json: $P/stability.json $P/gels.json $(CHARTED_GELS:%=$(MESH))
	$(call step,gelforge.stages.stability row $D $*)

$D/stability/map.json: $(STABILITY_FILES)
	$(call step,gelforge.stages.stability map $D)

# All networks but those fine-tuned from the shipped one. The plan's list is a prerequisite: a removed one has no date.
.PHONY: pareto-models
pareto-models: $D/pareto_models/$(RES1).json  ## accuracy against latency of every network: chart, CSV, JSON

$D/pareto_models/$(RES1).json: $P/networks.json $P/pareto_models.json $D/60_dataset/$(RES1)/dataset.json \
    $(LEARNABLE:%=$D/80_evaluate/$(RES1)/%.json) $(LEARNABLE:%=$D/70_train/$(RES1)/%.onnx)
	$(call step,gelforge.stages.pareto_models $D $(RES1) $(LEARNABLE))

# The last line sets the date of the shipped file on its sources: a network that was fine-tuned from the replaced one
# is then not outdated. Results of benchmark-unseen and benchmark-real for this network go into the card.
MEASURED := $(wildcard results/benchmarks/unseen.json results/benchmarks/real.json)

.PHONY: ship
ship: $D/70_train/$(RES1)/$(LEARNT).onnx $D/80_evaluate/$(RES1)/$(LEARNT).json  ## replace the shipped network by a trained one: make ship MODEL=… DATASET=…
	@$(PY) -m gelforge.stages.card $D $(RES1) $(LEARNT) --part --measured $(MEASURED) --ship $(SHIPPED).onnx.part
	cp $(<:.onnx=.safetensors) $(SHIPPED).safetensors
	mv $(SHIPPED).onnx.part $(SHIPPED).onnx
	mv $D/80_evaluate/$(RES1)/$(LEARNT).card.md.part $(SHIPPED).md
	touch -r $(SHIPPED).onnx $^ $(SHIPPED).safetensors
