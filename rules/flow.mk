# The stages. A rule names every file that its stage reads, because the record of its target holds their digests.

# 10: checks each row of the log, places each indenter's surface as the CNC did.
POSES := $(SHARDS:%=$D/10_poses/%.csv)

poses: $(POSES)  ## check the log, place every indenter's surface as the CNC did

$(POSES): $D/10_poses/%.csv: $(SHARD)/%.csv $(SHARD)/%.json $(SHARD)/%.pictures.json $P/poses.json
	$(call step,gelforge.stages.poses $D $*)

# Files of a shard: paths (by stage 10), bodies and sensors, images.
USED := $(SHARDS:%=$(SHARD)/%.json)
PICTURES := $(SHARDS:%=$(SHARD)/%.pictures.json)

# 15: checks that the images of the whole log show what its rows describe, before anything is solved.
IMAGES_JUDGED := $(if $(IMPORTED),,$(if $(IMAGES),$D/15_images/images.json))

images: $(IMAGES_JUDGED)  ## compare the images of the log with its poses and no-contact images

$D/15_images/images.json: $(POSES) $(USED) $(PICTURES) $(BESIDE)/nocontact.json $P/images.json $P/gels.json
	$(HANDS_SLOTS)$(call step,gelforge.stages.images $D)

# 20: tetrahedra of each gel, which stage 30 bisects for each press. Stages that read meshes of presses read these, too.
MESH = $D/20_meshes/%.npz
MESHED := $(MESHED_GELS:%=$(MESH))

meshes: $(GELS:%=$(MESH))  ## tetrahedra of each gel, with a .vtu to look at

$(sort $(GELS:%=$(MESH)) $(CHARTED_GELS:%=$(MESH))): $(MESH): $P/meshes.json $P/gels.json
	$(call step,gelforge.stages.meshes $D $*)

# 30: finite elements; a solve with unchanged inputs is not repeated.
FEA := $(SHARDS:%=$D/30_fea/%.csv)

fea: $(FEA) $(solved)  ## solve every accepted sample by finite elements

$(FEA): $D/30_fea/%.csv: $D/10_poses/%.csv $(SHARD)/%.json $P/fea.json $P/gels.json $(MESHED) | $(IMAGES_JUDGED)
	$(foretold)
	$(call solve,gelforge.stages.fea $D $*)

# 40: CALIBRATED is the posterior if [material] c10 = "calibrated": its median scales the forces, no solve is
# repeated.
FORCES := $(SHARDS:%=$D/40_forces/%.npz)

forces: $(FORCES)  ## nodal contact forces of the solves, scaled to the material

$(FORCES): $D/40_forces/%.npz: $D/30_fea/%.csv $P/forces.json $(MESHED) $(CALIBRATED:%=$D/%) | $(solved)
	$(call step,gelforge.stages.forces $D $*)

# 50: one process per resolution labels all shards, because starting one per shard would cost more than the labels.
LABELS := $(RES:%=$D/50_labels/%/labels.json)

labels: $(LABELS)  ## force per grid cell: make labels RES="12x16 24x32 48x64"

$(LABELS): $D/50_labels/%/labels.json: $(FORCES) $(MESHED) $(POSES) $D/00_plan/shards.csv $P/labels.json $P/sensors.json $P/gels.json
	$(call step,gelforge.stages.labels $D $*)

# 60: arrays ready for training, one folder per resolution. Imported labels (data/DATASET/labels) need no earlier
# stage.
DATASETS := $(RES:%=$D/60_dataset/%/dataset.json)
LABEL_SOURCE := $(if $(IMPORTED),$(BESIDE)/%.json $(SHARDS:%=$(SHARD)/%.csv),$D/50_labels/%/labels.json $(POSES) $(IMAGES_JUDGED))

dataset: $(DATASETS)  ## images and labels, split without leaks, with normalisation

$(DATASETS): $D/60_dataset/%/dataset.json: $(LABEL_SOURCE) $(PICTURES) $(BESIDE)/nocontact.json $(BESIDE)/rows.json \
    $P/dataset.json $P/indenters.json $P/sensors.json
	$(call step,gelforge.stages.dataset $D $*)

# 70: a model is a table of workflow/models.toml; RES names the grid.
SHIPPED := src/gelforge/reading/weights/default
# Models that fine-tune the shipped network (TUNED) are for one dataset and have the grid of that network: made by
# name only.
LEARNABLE := $(filter-out $(TUNED),$(MODELS))
TRAINED := $(MODELS:%=$D/70_train/$(RES1)/%.onnx)
# Other datasets to train on as well ([train] also). Each is made by its own run of make.
LEARNT_WITH := $(foreach name,$(LEARN_ALSO),results/$(name)/60_dataset/$(if $(wildcard data/$(name)/labels/1x1.npz),1x1,$(RES1))/dataset.json)

train: $D/70_train/$(RES1)/$(LEARNT).onnx  ## train one network, write it as ONNX: make train MODEL=pair_16 RES=24x32

$(TRAINED): $D/70_train/$(RES1)/%.onnx: $D/60_dataset/$(RES1)/dataset.json $P/models/%.json $P/train.json $(LEARNT_WITH)
	$(foretold)
	$(call train,gelforge.stages.train $D $(RES1) $*)

$(TUNED:%=$D/70_train/$(RES1)/%.onnx): $(SHIPPED).safetensors

# 80: errors of a network, and its model card; also of the shipped network, on a dataset that it was not trained on.
EVALUATED := $(MODELS:%=$D/80_evaluate/$(RES1)/%.json)
READ := $D/80_evaluate/$(RES1)/shipped.json
CARDS := $(EVALUATED:.json=.card.md) $(READ:.json=.card.md)

evaluate:  ## errors of one network against labels, baselines and force sensors; its card
evaluate: $D/80_evaluate/$(RES1)/$(MODEL).json $D/80_evaluate/$(RES1)/$(MODEL).card.md

$(EVALUATED): $D/80_evaluate/$(RES1)/%.json: $D/70_train/$(RES1)/%.onnx
$(READ) $(READ:.json=.card.md): $(SHIPPED).onnx
$(EVALUATED) $(READ): $D/80_evaluate/$(RES1)/%.json: $D/60_dataset/$(RES1)/dataset.json $P/evaluate.json
	$(call step,gelforge.stages.evaluate $D $(RES1) $*)

$(EVALUATED:.json=.card.md): $D/80_evaluate/$(RES1)/%.card.md: $D/70_train/$(RES1)/%.onnx
$(CARDS): $D/80_evaluate/$(RES1)/%.card.md: $D/80_evaluate/$(RES1)/%.json $P/card.json
	$(call step,gelforge.stages.card $D $(RES1) $*)

# 90: a dataset with imported labels has no solves, and its log may have no poses. The page prints the parameters of
# every stage. The choice of network and branches is a file, so that a changed choice is newer than the report.
REPORT := $D/90_report/index.html
SOLVED := $(if $(IMPORTED),,$(POSES) $(MESHED) $(FEA) $(FORCES) $D/50_labels/$(RES1)/labels.json $(IMAGES_JUDGED))

report: $(REPORT)  ## one HTML page: presses, labels, errors, posterior, chart, failures

$(REPORT): $(wildcard $P/*.json) $(CHOICE)/report.txt $(SHARDS:%=$(SHARD)/%.csv) $(USED) $(PICTURES) $(SOLVED) $(IS_FROZEN) \
    $D/60_dataset/$(RES1)/dataset.json $D/80_evaluate/$(RES1)/$(MODEL).json $(SHOWN)
	$(call step,gelforge.stages.report $D $(RES1) $(MODEL))
