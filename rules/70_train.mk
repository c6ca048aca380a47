# Stage 70: networks. A model is a table of workflow/models.toml; RES names the grid.
SHIPPED := src/gelforge/reading/weights/default
# Those that fine-tune the shipped network (TUNED) are for one dataset, and write its grid: they are made by name alone.
LEARNABLE := $(filter-out $(TUNED),$(MODELS))
TRAINED := $(MODELS:%=$D/70_train/$(RES1)/%.onnx)

train: $D/70_train/$(RES1)/$(LEARNT).onnx  ## train one network, write it as ONNX: make train MODEL=grid_16 RES=24x32

# Other datasets that are learnt from as well ([train] also). They are made by themselves; flow/asked.py refuses where
# one is missing.
LEARNT_WITH := $(LEARN_ALSO:%=results/%/60_dataset/$(RES1)/dataset.json)

$(TRAINED): $D/70_train/$(RES1)/%.onnx: $D/60_dataset/$(RES1)/dataset.json $P/models/%.json $P/train.json $(LEARNT_WITH)
	$(call step,gelforge.stages.train $D $(RES1) $*)

$(TUNED:%=$D/70_train/$(RES1)/%.onnx): $(SHIPPED).safetensors
