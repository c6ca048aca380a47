# Stage 70: networks. A model is a table of workflow/models.toml; RES names the grid.
MODELS := $(shell sed -nE 's/^\[([a-z0-9_]+)\]$$/\1/p' workflow/models.toml)
# The shipped network is never trained here.
LEARNT = $(if $(filter shipped,$(MODEL)),$(LEARNER),$(MODEL))
TRAINED := $(MODELS:%=$D/70_train/$(RES1)/%.pt)

.PHONY: train models onnx
train: $D/70_train/$(RES1)/$(LEARNT).pt  ## one network: make train MODEL=grid_16 RES=24x32
models: $(TRAINED)  ## every network of workflow/models.toml
onnx: $D/70_train/$(RES1)/onnx/$(LEARNT).onnx  ## a trained network as ONNX, checked against torch

$(TRAINED): $D/70_train/$(RES1)/%.pt: $D/60_dataset/$(RES1)/dataset.json $P/models/%.json $P/train.json
	$(call step,gelforge.stages.train --dataset $(<D) --model $* --models $P/models/$*.json --params $P/train.json --out $@.part)

$(MODELS:%=$D/70_train/$(RES1)/onnx/%.onnx): $D/70_train/$(RES1)/onnx/%.onnx: $D/70_train/$(RES1)/%.pt
	$(call step,gelforge.stages.onnx --model $< --out $@.part)
