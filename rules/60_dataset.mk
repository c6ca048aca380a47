# Stage 60: arrays ready to train on, one folder per resolution. Imported labels (data/DATASET/labels) need no stage 50.
DATASETS := $(RES:%=$D/60_dataset/%/dataset.json)
LABEL_SOURCE := $(if $(IMPORTED),$(DATA)/labels/%.npz $D/00_plan/shards.csv,$D/50_labels/%/labels.json $(POSES))

dataset: $(DATASETS)  ## images and labels, split without leaks, with normalisation

# Digests of the no-contact images, and of splits, truth and imported labels beside the log.
BESIDE := $(addprefix $D/00_plan/,nocontact.json beside.json)

$(DATASETS): $D/60_dataset/%/dataset.json: \
    $(LABEL_SOURCE) $(IMAGES_JUDGED) $(BESIDE) $P/dataset.json $P/indenters.json $P/sensors.json \
    | $(call barrier,10_poses)
	$(call step,gelforge.stages.dataset $D $*)
