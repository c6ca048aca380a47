# Stage 60: arrays ready to train on, one folder per resolution. Imported labels (data/DATASET/labels) need no stage 50.
DATASETS := $(RES:%=$D/60_dataset/%/dataset.json)
IMPORTED := $(wildcard $(DATA)/labels)
LABEL_SOURCE := $(if $(IMPORTED),$(DATA)/labels/%.npz,$D/50_labels/%/labels.json)

# Pictures of untouched sensors; make cannot name a file with a space in it, and none of the sensors has one.
UNTOUCHED := $(if $(wildcard $(DATA)/nocontact),$(shell find $(DATA)/nocontact -name "*.png" ! -name "* *"))

.PHONY: dataset
dataset: $(DATASETS)  ## images, labels, split without leaks, normalisation

$(DATASETS): $D/60_dataset/%/dataset.json: $(LABEL_SOURCE) $(POSES) $(wildcard $(DATA)/truth/presses.csv $(DATA)/splits.csv) $(UNTOUCHED) $P/dataset.json $P/indenters.json $P/sensors.json | $(call barrier,10_poses)
	$(call step,gelforge.stages.dataset --data $(DATA) --labels $(if $(IMPORTED),$<,$(<D)) --poses $D/10_poses --shards $D/00_plan/shards --catalogue $P/indenters.json --sensors $P/sensors.json --resolution $* --params $P/dataset.json --out $@.part)
