# Stage 60: arrays ready to train on, one folder per resolution. Imported labels (data/DATASET/labels) need no stage 50.
DATASETS := $(RES:%=$D/60_dataset/%/dataset.json)
IMPORTED := $(wildcard $(DATA)/labels)
# Of imported labels there are the resolutions that they came in.
IMPORTED_RES = $(basename $(notdir $(wildcard $(DATA)/labels/*.npz)))
$(DATA)/labels/%.npz:
	$(error $(DATA) was imported with labels of $(IMPORTED_RES), not of $*: say RES=$(firstword $(IMPORTED_RES)))
LABEL_SOURCE := $(if $(IMPORTED),$(DATA)/labels/%.npz,$D/50_labels/%/labels.json)

# What lies beside the log: no-contact images, splits and truth that the dataset came with. A digest of names,
# sizes and times shows when one of them goes, or an older file takes its place.
BESIDE := $(wildcard $(DATA)/nocontact $(DATA)/splits.csv $(DATA)/truth/presses.csv)
BESIDE_DIGEST := $(if $(BESIDE),$(shell LC_ALL=C find -L $(BESIDE) -type f -printf '%p %s %T@\n' | LC_ALL=C sort | sha256sum | cut -c 1-32))

.PHONY: dataset
dataset: $(DATASETS)  ## images and labels, split without leaks, with normalisation

$(DATASETS): $D/60_dataset/%/dataset.json: $(LABEL_SOURCE) $(if $(IMPORTED),$D/00_plan/shards.csv,$(POSES)) $(IMAGES_JUDGED) $D/60_dataset/beside.txt $P/dataset.json $P/indenters.json $P/sensors.json | $(call barrier,10_poses)
	$(call step,gelforge.stages.dataset --data $(DATA) --labels $(if $(IMPORTED),$<,$(<D)) --poses $D/10_poses --shards $D/00_plan/shards $(if $(IMAGES_JUDGED),--images $(IMAGES_JUDGED)) --catalogue $P/indenters.json --sensors $P/sensors.json --resolution $* --params $P/dataset.json $(if $(STRICT),--strict) --out $@.part)

# STRICT=1 after a make without it: datasets with presses that share a picture are judged again, and fail.
$(if $(STRICT),$(shell grep -ls '"repeated_pictures"' $D/60_dataset/*/dataset.json)): strict

$(eval $(call choice,$D/60_dataset/beside.txt,$(BESIDE_DIGEST)))

# Imported labels are other ones where an older file takes their place, and where they come or go.
define imported
$D/60_dataset/$(1)/dataset.json: $D/60_dataset/$(1).labels.txt
$(call choice,$D/60_dataset/$(1).labels.txt,$(if $(IMPORTED),$(shell LC_ALL=C stat -L -c '%.9Y %s' $(DATA)/labels/$(1).npz 2>/dev/null || true)))
endef
$(foreach r,$(sort $(RES)),$(if $(IMPORTED)$(wildcard $D/60_dataset/$r.labels.txt),$(eval $(call imported,$r))))
