# Stage 80: how wrong a network is, and its model card.
EVALUATED := $(MODELS:%=$D/80_evaluate/$(RES1)/%.json)

.PHONY: evaluate evaluate-models ship
evaluate: $D/80_evaluate/$(RES1)/$(MODEL).json $D/80_evaluate/$(RES1)/$(MODEL).card.md  ## errors of one network against labels, baselines and force sensors; its card
evaluate-models: $(LEARNABLE:%=$D/80_evaluate/$(RES1)/%.json)  ## evaluate every network

$(EVALUATED): $D/80_evaluate/$(RES1)/%.json: $D/70_train/$(RES1)/%.onnx $D/60_dataset/$(RES1)/dataset.json $P/evaluate.json
	$(call step,gelforge.stages.evaluate --dataset $(dir $(word 2,$^)) --model $< --params $P/evaluate.json --out $@.part)

# The shipped network, on a dataset that it did not learn from.
READ := $D/80_evaluate/$(RES1)/shipped.json

$(READ): $(SHIPPED).onnx $D/60_dataset/$(RES1)/dataset.json $P/evaluate.json
	$(call step,gelforge.stages.evaluate --dataset $(dir $(word 2,$^)) --model $< --params $P/evaluate.json --out $@.part)

$(READ:.json=.card.md): $(SHIPPED).onnx $(READ) $P/card.json
	$(call step,gelforge.stages.card --model $< --evaluation $(word 2,$^) --out $@.part)

$(EVALUATED:.json=.card.md): $D/80_evaluate/$(RES1)/%.card.md: $D/70_train/$(RES1)/%.onnx $D/80_evaluate/$(RES1)/%.json $P/card.json
	$(call step,gelforge.stages.card --model $< --evaluation $(word 2,$^) --out $@.part)

# It takes the time of its copy: one that went on from the network whose place it takes is not trained again for that.
# What benchmark-unseen and benchmark-real measured of this very network goes into the card.
ship: $D/70_train/$(RES1)/$(LEARNT).onnx $D/80_evaluate/$(RES1)/$(LEARNT).json  ## make a network the default of predict and live
	@$(PY) -m gelforge.stages.card --model $< --evaluation $(word 2,$^) --measured $(wildcard results/benchmarks/unseen.json results/benchmarks/real.json) --out $(SHIPPED).md.part
	cp $< $(SHIPPED).onnx.part
	cp $(<:.onnx=.safetensors) $(SHIPPED).safetensors
	mv $(SHIPPED).onnx.part $(SHIPPED).onnx
	mv $(SHIPPED).md.part $(SHIPPED).md
	touch -r $(SHIPPED).onnx $^ $(SHIPPED).safetensors
