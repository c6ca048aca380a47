# FEATS' files in and out.
FROM ?=
EXPORTED := $(RES:%=$D/feats/%/normalization_gelforge.npy)

.PHONY: feats-import feats-export
feats-import: SENSOR ?= feats_mini
feats-import: $(SETUP)  ## FEATS' .npy files to data/DATASET: make feats-import FROM=folder DATASET=name SENSOR=name
	@$(PY) -m gelforge.commands.feats import --from $(call given,FROM) --data $(DATA) --sensor $(SENSOR)

feats-export: $(EXPORTED)  ## our labels as FEATS' folders, normalisation file included

$(EXPORTED): $D/feats/%/normalization_gelforge.npy: $D/60_dataset/%/dataset.json
	$(call step,gelforge.commands.feats export --dataset $(<D) --folder $(@D) --out $@.part)
