EXPORTED := $(RES:%=$D/feats/%/normalization_gelforge.npy)

# The dataset as it is published: DATASET is feats where no other is named.
PUBLISHED := data/$(if $(call by_hand,DATASET),$(DATASET),feats)

feats-fetch: $(SETUP)  ## import FEATS' published dataset to data/feats, all or SPLIT="train val", of a copy FROM=folder
	@$(PY) -m gelforge.commands.feats fetch --from $(call given,FROM) --split $(call given,SPLIT) \
	    --downloads downloads/feats --data $(PUBLISHED)

feats-import: SENSOR ?= feats_mini
feats-import: $(SETUP)  ## import FEATS' .npy files: make feats-import FROM=folder DATASET=name SENSOR=name
	@$(PY) -m gelforge.commands.feats import --from $(call given,FROM) --data $(DATA) --sensor $(SENSOR)

feats-export: $(EXPORTED)  ## write labels in FEATS' layout, with its normalisation file

$(EXPORTED): $D/feats/%/normalization_gelforge.npy: $D/60_dataset/%/dataset.json
	$(call step,gelforge.commands.feats export $D $*)
