# Stage 80: how wrong a network is, and its model card.
EVALUATED := $(MODELS:%=$D/80_evaluate/$(RES1)/%.json)
# The shipped network, on a dataset that it did not learn from.
READ := $D/80_evaluate/$(RES1)/shipped.json
CARDS := $(EVALUATED:.json=.card.md) $(READ:.json=.card.md)

evaluate:  ## errors of one network against labels, baselines and force sensors; its card
evaluate: $D/80_evaluate/$(RES1)/$(MODEL).json $D/80_evaluate/$(RES1)/$(MODEL).card.md

$(EVALUATED): $D/80_evaluate/$(RES1)/%.json: $D/70_train/$(RES1)/%.onnx
$(READ): $(SHIPPED).onnx
$(EVALUATED) $(READ): $D/80_evaluate/$(RES1)/%.json: $D/60_dataset/$(RES1)/dataset.json $P/evaluate.json
	$(call step,gelforge.stages.evaluate $D $(RES1) $*)

$(EVALUATED:.json=.card.md): $D/80_evaluate/$(RES1)/%.card.md: $D/70_train/$(RES1)/%.onnx
$(READ:.json=.card.md): $(SHIPPED).onnx
$(CARDS): $D/80_evaluate/$(RES1)/%.card.md: $D/80_evaluate/$(RES1)/%.json $P/card.json
	$(call step,gelforge.stages.card $D $(RES1) $*)

# It takes the time of its copy: one that went on from the network whose place it takes is not trained again for that.
# What benchmark-unseen and benchmark-real measured of this very network goes into the card.
MEASURED := $(wildcard results/benchmarks/unseen.json results/benchmarks/real.json)

ship: $D/70_train/$(RES1)/$(LEARNT).onnx $D/80_evaluate/$(RES1)/$(LEARNT).json  ## make a network the default one
	@$(PY) -m gelforge.stages.card $D $(RES1) $(LEARNT) --part --measured $(MEASURED) --ship $(SHIPPED).onnx.part
	cp $(<:.onnx=.safetensors) $(SHIPPED).safetensors
	mv $(SHIPPED).onnx.part $(SHIPPED).onnx
	mv $D/80_evaluate/$(RES1)/$(LEARNT).card.md.part $(SHIPPED).md
	touch -r $(SHIPPED).onnx $^ $(SHIPPED).safetensors
