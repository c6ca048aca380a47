# All networks but those that go on from the one that ships, or a list: make pareto-models CHARTED="grid_16 unet".
CHARTED ?= $(LEARNABLE)

pareto-models: $D/pareto_models/$(RES1).json  ## accuracy against latency of every network: chart, CSV, JSON

$D/pareto_models/$(RES1).json: $P/pareto_models.json $D/60_dataset/$(RES1)/dataset.json \
    $(CHARTED:%=$D/80_evaluate/$(RES1)/%.json) $(CHARTED:%=$D/70_train/$(RES1)/%.onnx)
	$(call step,gelforge.stages.pareto_models $D $(RES1) $(CHARTED))
