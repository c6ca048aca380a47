# The stages. A rule names every file that its stage reads, because the record of its target holds their digests.

# What labels follow: CALIBRATION is data/DATASET/calibration.toml if there is one, else the posterior if the dataset
# asks for it ([material] c10 = "calibrated"), else nothing. It moves poses, scales forces and sets friction.

# Files of a shard: bodies and sensors, images.
USED := $(SHARDS:%=$(SHARD)/%.json)
PICTURES := $(SHARDS:%=$(SHARD)/%.pictures.json)

# 15: checks that the images of the whole log show what its rows describe, by commanded paths, before anything is solved:
# a calibration, on which stage 10 may wait, waits for this stage.
IMAGES_JUDGED := $(if $(IMPORTED),,$(if $(IMAGES),$D/15_images/images.json))

.PHONY: images
images: $(IMAGES_JUDGED)  ## compare the images of the log with its poses and no-contact images

$D/15_images/images.json: $(SHARDS:%=$(SHARD)/%.csv) $(USED) $(PICTURES) $(BESIDE)/nocontact.json $P/images.json $P/gels.json $P/spare.json
	$(HANDS_SLOTS)$(call step,gelforge.stages.images $D)

# 10: checks each row of the log, places each indenter's surface as the CNC did.
POSES := $(SHARDS:%=$D/10_poses/%.csv)

.PHONY: poses
poses: $(POSES)  ## check the log, place every indenter's surface as the CNC did

$(POSES): $D/10_poses/%.csv: $(SHARD)/%.csv $(SHARD)/%.json $(SHARD)/%.pictures.json $P/poses.json $(CALIBRATION) | $D/00_plan/shards.csv
	$(call step,gelforge.stages.poses $D $*)

# 20: tetrahedra of each gel, which stage 30 bisects for each press. Stages that read meshes of presses read these, too.
MESH = $D/20_meshes/%.npz
MESHED := $(MESHED_GELS:%=$(MESH))

.PHONY: meshes
meshes: $(GELS:%=$(MESH))  ## tetrahedra of each gel, with a .vtu to look at

$(sort $(GELS:%=$(MESH)) $(CHARTED_GELS:%=$(MESH))): $(MESH): $P/meshes.json $P/gels.json
	$(call step,gelforge.stages.meshes $D $*)

# 30: finite elements. Solves are kept in one store by a key of their inputs, so that none is made twice.
FEA := $(SHARDS:%=$D/30_fea/%.csv)

.PHONY: fea
fea: $(FEA)  ## solve every accepted sample by finite elements

$(FEA): $D/30_fea/%.csv: $D/10_poses/%.csv $(SHARD)/%.json $P/fea.json $(MESHED) $(CALIBRATION) | $(IMAGES_JUDGED)
	$(call step,gelforge.stages.fea $D $*)

# 40: the material's C10 scales the forces, no solve is repeated.
FORCES := $(SHARDS:%=$D/40_forces/%.npz)

.PHONY: forces
forces: $(FORCES)  ## nodal contact forces of the solves, scaled to the material

$(FORCES): $D/40_forces/%.npz: $D/30_fea/%.csv $P/forces.json $(MESHED) $(CALIBRATION)
	$(call step,gelforge.stages.forces $D $*)

# 50: force per cell of an image grid, a file per shard and resolution.
LABELS := $(foreach r,$(RES),$(SHARDS:%=$D/50_labels/$r/%.npz))

.PHONY: labels
labels: $(LABELS)  ## force per grid cell: make labels RES="12x16 24x32 48x64"

define labelled_at
$(SHARDS:%=$D/50_labels/$1/%.npz): $D/50_labels/$1/%.npz: $D/40_forces/%.npz $D/10_poses/%.csv $(SHARD)/%.json $P/labels.json $(MESHED)
	$$(call step,gelforge.stages.labels $D $1 $$*)
endef
$(foreach r,$(RES),$(eval $(call labelled_at,$r)))

# 60: arrays ready for training, one folder per resolution. Imported labels (data/DATASET/labels) need no earlier
# stage.
DATASETS := $(RES:%=$D/60_dataset/%/dataset.json)

.PHONY: dataset
dataset: $(DATASETS)  ## images and labels, split without leaks, with normalisation

define collected_at
$D/60_dataset/$1/dataset.json: $(if $(IMPORTED),$(BESIDE)/$1.json $(SHARDS:%=$(SHARD)/%.csv),$(SHARDS:%=$D/50_labels/$1/%.npz) $(POSES) \
    $(IMAGES_JUDGED)) $(PICTURES) $(BESIDE)/nocontact.json $(BESIDE)/rows.json $P/dataset.json $P/indenters.json $P/sensors.json
	$$(call step,gelforge.stages.dataset $D $1)
endef
$(foreach r,$(RES),$(eval $(call collected_at,$r)))

# 70: a model is a table of workflow/models.toml; RES names the grid.
SHIPPED := src/gelforge/reading/weights/default
TRAINED := $(MODELS:%=$D/70_train/$(RES1)/%.onnx)

.PHONY: train
train: $D/70_train/$(RES1)/$(LEARNT).onnx  ## train one network, write it as ONNX: make train MODEL=pair_16 RES=24x32

$(TRAINED): $D/70_train/$(RES1)/%.onnx: $D/60_dataset/$(RES1)/dataset.json $P/models/%.json $P/train.json $(LEARNT_WITH)
	$(call step,gelforge.stages.train $D $(RES1) $*)

$(TUNED:%=$D/70_train/$(RES1)/%.onnx): $(SHIPPED).safetensors $(SHIPPED).onnx

ifeq ($(EXECUTOR),slurm)
$(FEA) $(TRAINED): LAUNCHED := $(ON_CLUSTER)
endif

# 80: errors of a network, and its model card; also of the shipped network, on a dataset that it was not trained on.
NETWORKS := $(MODELS) shipped
EVALUATED := $(NETWORKS:%=$D/80_evaluate/$(RES1)/%.json)

.PHONY: evaluate
evaluate: $D/80_evaluate/$(RES1)/$(NET).json $D/80_evaluate/$(RES1)/$(NET).card.md  ## errors of one network against labels, baselines and force sensors; its card

$(MODELS:%=$D/80_evaluate/$(RES1)/%.json): $D/80_evaluate/$(RES1)/%.json: $D/70_train/$(RES1)/%.onnx
$D/80_evaluate/$(RES1)/shipped.json: $(SHIPPED).onnx
$(EVALUATED): $D/80_evaluate/$(RES1)/%.json: $D/60_dataset/$(RES1)/dataset.json $P/evaluate.json
	$(call step,gelforge.stages.evaluate $D $(RES1) $*)

$(MODELS:%=$D/80_evaluate/$(RES1)/%.card.md): $D/80_evaluate/$(RES1)/%.card.md: $D/70_train/$(RES1)/%.onnx
$D/80_evaluate/$(RES1)/shipped.card.md: $(SHIPPED).onnx
$(EVALUATED:.json=.card.md): $D/80_evaluate/$(RES1)/%.card.md: $D/80_evaluate/$(RES1)/%.json $P/card.json
	$(call step,gelforge.stages.card $D $(RES1) $*)

# 90: a page for each grid and network. A dataset with imported labels has no solves; one without images, or with too
# few of them, has no network: its page ends at labels and calibration. Branches are shown if [report] names them, or
# if they were made.
PAGE_NET := $(if $(IMPORTED)$(IMAGES),$(NET),none)
REPORT := $D/90_report/$(RES1)-$(PAGE_NET).html
SHOWN := $(sort $(BRANCHES:%=$D/%) $(wildcard $D/calibrate/summary.json $D/pareto/pareto.json))
SHOWN += $(if $(filter $D/calibrate/summary.json,$(SHOWN)),$D/calibrate/plots.json)
# A network of one's own stands beside the shipped one, where that reads the dataset.
BOTH := $(if $(filter $(SHIPPED_RES),$(RES1)),$(if $(wildcard $(DATA)/nocontact),shipped))
OWN_NET := $(patsubst %,$D/70_train/$(RES1)/%.onnx,$(filter $(MODELS),$(NET)))
JUDGED := $(if $(filter none,$(PAGE_NET)),,$D/60_dataset/$(RES1)/dataset.json $(OWN_NET) $(patsubst %,$D/80_evaluate/$(RES1)/%.json,$(sort $(NET) $(BOTH))))
SOLVED := $(if $(IMPORTED),,$(POSES) $(MESHED) $(FEA) $(FORCES) $(SHARDS:%=$D/50_labels/$(RES1)/%.npz) $(IMAGES_JUDGED))

.PHONY: report
report: $(REPORT)  ## one HTML page: presses, labels, errors, posterior, chart, failures

$(REPORT): $(PARAMETERS:%=$P/%.json) $(wildcard results/readme/exact.png) $(SHARDS:%=$(SHARD)/%.csv) $(USED) $(PICTURES) $(SOLVED) $(CALIBRATION) $(JUDGED) $(SHOWN)
	$(call step,gelforge.stages.report $D $(RES1) $(PAGE_NET))
