# Stage 60: arrays ready to train on, one folder per resolution. Imported labels (data/DATASET/labels) need no stage 50.
DATASETS := $(RES:%=$D/60_dataset/%/dataset.json)
IMPORTED := $(wildcard $(DATA)/labels)
LABEL_SOURCE := $(if $(IMPORTED),$(DATA)/labels/%.npz,$D/50_labels/%/labels.json)

.PHONY: dataset
dataset: $(DATASETS)  ## images and labels, split without leaks, with normalisation

dataset_of = gelforge.stages.dataset --data $(DATA) --labels $(if $(IMPORTED),$<,$(<D)) --poses $D/10_poses \
    --shards $D/00_plan/shards $(IMAGES_JUDGED:%=--images %) --catalogue $P/indenters.json --sensors $P/sensors.json \
    --resolution $* --params $P/dataset.json $(if $(STRICT),--strict) --out $@.part

# nocontact.json, beside.json: digests of the no-contact images, and of splits, truth and imported labels beside the log.
$(DATASETS): $D/60_dataset/%/dataset.json: $(LABEL_SOURCE) $(if $(IMPORTED),$D/00_plan/shards.csv,$(POSES)) \
    $(IMAGES_JUDGED) $(addprefix $D/00_plan/,nocontact.json beside.json) $P/dataset.json $P/indenters.json $P/sensors.json \
    | $(call barrier,10_poses)
	$(call step,$(dataset_of))
