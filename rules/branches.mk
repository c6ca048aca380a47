# Branches: calibrate, pareto, stability, the chart of networks, and a network that takes the place of the shipped one.

# Posterior of C10 and of what the bench does to the measurement, from the log's forces. Solves, chain and pictures lie beside the
# summary, which is published last. It reads the path as commanded: poses that a frozen calibration moved make it no other.
POSTERIOR := $D/calibrate/summary.json

calibrate: $(POSTERIOR)  ## posterior of C10, touch offset, compliance and friction from the log's force readings

$(POSTERIOR): $(SHARDS:%=$(SHARD)/%.csv) $P/about.json $P/calibrate.json $P/indenters.json $P/sensors.json $P/gels.json | $(POSES)
	$(foretold)
	$(HANDS_SLOTS)$(call step,gelforge.stages.calibrate $D)

freeze: $(POSTERIOR)  ## write the posterior to data/DATASET/calibration.toml: labels use it until the next make freeze
	@$(PY) -m gelforge.commands.freeze $D

# Another make reads what was frozen: poses and stiffness of this one are those before.
frozen_then = $(if $(IS_FROZEN),,@export HAS_SLOTS=yes; $(MAKE) --no-print-directory freeze && $(MAKE) --no-print-directory $1)

calibrated-labels: $(if $(IS_FROZEN),labels)  ## calibrate by the log's forces, freeze the result, make labels with it
	$(call frozen_then,labels)

demo: $(if $(IS_FROZEN),report)  ## the whole flow on the demo dataset: labels, predictions of the shipped network, calibration, report
	$(call frozen_then,report)
	@echo "report: $D/90_report/index.html"

# Seconds against error of every solver, mesh density and load-step count, on the scenes of workflow/scenes.toml: an hour; a scene that
# is cut short resumes at its next method. References are kept in data/; one whose scene or settings changed is solved anew.
KEPT_REFERENCES := $(wildcard data/fea_challenge/keys.json)
PARETO_FILES := $(PARETO_SCENES:%=$D/pareto/scenes/%.json)

pareto: $D/pareto/pareto.json  ## speed against accuracy of the mechanics: chart, CSV, JSON (an hour; resumes)

$(PARETO_FILES): $D/pareto/scenes/%.json: $P/pareto.json $P/scenes/%.json $P/sensors.json $P/gels.json $(KEPT_REFERENCES)
	$(foretold)
	$(call step,gelforge.stages.pareto scene $D $*)

$D/pareto/pareto.json: $(PARETO_FILES) $P/pareto.json $P/scenes.json
	$(call step,gelforge.stages.pareto chart $D)

# It refuses references whose keys are of other methods or of another version of the chart.
fea-challenge: $(SETUP)  ## write the scenes as an open benchmark for simulators: results/fea_challenge
	@$(PY) -m gelforge.stages.challenge write results/fea_challenge

fea-references: $(PARETO_FILES)  ## make the references of fea-challenge again from the large chart (hours)
	@$(PY) -m gelforge.stages.challenge references $D

# Where the mechanics converge: one target per factor; solved cases are kept, so that a row that is cut short resumes.
STABILITY_ROWS := depth shear place tilt ridge nu friction size steps random
STABILITY_FILES := $(STABILITY_ROWS:%=$D/stability/rows/%.json)

stability: $D/stability/map.json  ## where the mechanics converge, fail or lose accuracy: map, CSV (an hour or two; resumes)

$(STABILITY_FILES): $D/stability/rows/%.json: $P/stability.json $P/gels.json
	$(foretold)
	$(call step,gelforge.stages.stability row $D $*)

$D/stability/map.json: $(STABILITY_FILES)
	$(call step,gelforge.stages.stability map $D)

# All networks but those that go on from the one that ships, or a list: make pareto-models CHARTED="pair_16 unet".
CHARTED ?= $(LEARNABLE)

pareto-models: $D/pareto_models/$(RES1).json  ## accuracy against latency of every network: chart, CSV, JSON

$D/pareto_models/$(RES1).json: $(CHOICE)/pareto_models-$(RES1).txt $P/pareto_models.json $D/60_dataset/$(RES1)/dataset.json \
    $(CHARTED:%=$D/80_evaluate/$(RES1)/%.json) $(CHARTED:%=$D/70_train/$(RES1)/%.onnx)
	$(call step,gelforge.stages.pareto_models $D $(RES1) $(CHARTED))

# It takes the time of its copy: one that went on from the network whose place it takes is not trained again for that.
# What benchmark-unseen and benchmark-real measured of this very network goes into the card.
MEASURED := $(wildcard results/benchmarks/unseen.json results/benchmarks/real.json)

ship: $D/70_train/$(RES1)/$(LEARNT).onnx $D/80_evaluate/$(RES1)/$(LEARNT).json  ## make a network the default one
	@$(PY) -m gelforge.stages.card $D $(RES1) $(LEARNT) --part --measured $(MEASURED) --ship $(SHIPPED).onnx.part
	cp $(<:.onnx=.safetensors) $(SHIPPED).safetensors
	mv $(SHIPPED).onnx.part $(SHIPPED).onnx
	mv $D/80_evaluate/$(RES1)/$(LEARNT).card.md.part $(SHIPPED).md
	touch -r $(SHIPPED).onnx $^ $(SHIPPED).safetensors
