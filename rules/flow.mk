# The stages. A rule names every file that its stage reads, because the record of its target holds their digests; what makes
# the target is the recipe of rules/run.mk.

# What labels follow: CALIBRATION is data/DATASET/calibration.toml if there is one, else the posterior if the dataset
# asks for it ([material] c10 = "calibrated"), else nothing. It moves poses, scales forces and sets friction: FOLLOWED has
# its values, the same before and after `make freeze`.
FOLLOWED := $(if $(CALIBRATION),$D/calibrate/followed.toml)
$D/calibrate/followed.toml: $(CALIBRATION)

# Rows of a shard; its bodies and sensors; its images.
ROWS := $(SHARDS:%=$(SHARD)/%.csv)
USED := $(SHARDS:%=$(SHARD)/%.json)
PICTURES := $(SHARDS:%=$(SHARD)/%.pictures.json)

.PHONY: poses images meshes fea forces labels dataset train evaluate report demo

# 15: checks that the images of the whole log show what its rows describe, by commanded paths, before anything is solved:
# a calibration, on which stage 10 may wait, waits for this stage.
IMAGES_JUDGED := $(if $(IMPORTED),,$(if $(IMAGES),$D/15_images/images.json))
images: $(IMAGES_JUDGED)  ## compare the images of the log with its poses and no-contact images
$D/15_images/images.json: $(ROWS) $(USED) $(PICTURES) $(BESIDE)/nocontact.json $P/images.json $P/gels.json $P/spare.json

# 10: checks each row of the log, places each indenter's surface as the CNC did.
POSES := $(SHARDS:%=$D/10_poses/%.csv)
poses: $(POSES)  ## check the log, place every indenter's surface as the CNC did
$(POSES): $D/10_poses/%.csv: $(SHARD)/%.csv $(SHARD)/%.json $(SHARD)/%.pictures.json $P/poses.json $(FOLLOWED) | $D/00_plan/shards.csv

# 20: tetrahedra of each gel, which stage 30 bisects for each press. Stages that read meshes of presses read these, too.
MESH = $D/20_meshes/%.npz
MESHED := $(MESHED_GELS:%=$(MESH))
meshes: $(GELS:%=$(MESH))  ## tetrahedra of each gel, with a .vtu to look at
$(sort $(GELS:%=$(MESH)) $(CHARTED_GELS:%=$(MESH))): $P/meshes.json $P/gels.json

# 30: finite elements. Solves are kept in one store by a key of their inputs, so that none is made twice.
FEA := $(SHARDS:%=$D/30_fea/%.csv)
fea: $(FEA)  ## solve every accepted sample by finite elements
$(FEA): $D/30_fea/%.csv: $D/10_poses/%.csv $(SHARD)/%.json $P/fea.json $(MESHED) $(FOLLOWED) | $(IMAGES_JUDGED)

# 40: the material's C10 scales the forces, no solve is repeated.
FORCES := $(SHARDS:%=$D/40_forces/%.npz)
forces: $(FORCES)  ## nodal contact forces of the solves, scaled to the material
$(FORCES): $D/40_forces/%.npz: $D/30_fea/%.csv $P/forces.json $(MESHED) $(FOLLOWED)

# From here on, $$ in prerequisites is expanded for each target: $$(*F) is its shard.
.SECONDEXPANSION:

# 50: force per cell of an image grid, a file per shard and resolution.
LABELS := $(foreach r,$(RES),$(SHARDS:%=$D/50_labels/$r/%.npz))
labels: possible $(LABELS)  ## force per grid cell: make labels RES="12x16 24x32 48x64"
$(LABELS): $D/50_labels/%.npz: $D/40_forces/$$(*F).npz $D/10_poses/$$(*F).csv $(SHARD)/$$(*F).json $P/labels.json $(MESHED)

# 60: arrays ready for training, one folder per resolution. Imported labels (data/DATASET/labels) need no earlier
# stage.
DATASETS := $(RES:%=$D/60_dataset/%/dataset.json)
dataset: possible $(DATASETS)  ## images and labels, split without leaks, with normalisation
LABELLED := $(if $(IMPORTED),$(BESIDE)/%.json $(ROWS),$(SHARDS:%=$D/50_labels/$$*/%.npz) $(POSES) $(IMAGES_JUDGED))
$(DATASETS): $D/60_dataset/%/dataset.json: $(LABELLED) $(PICTURES) $(BESIDE)/nocontact.json $(BESIDE)/rows.json $P/dataset.json \
    $P/indenters.json $P/sensors.json

# 70: a model is a table of workflow/models.toml; RES names the grid.
SHIPPED := src/gelforge/reading/weights/default
TRAINED := $(MODELS:%=$D/70_train/$(RES1)/%.onnx)
train: possible $D/70_train/$(RES1)/$(LEARNT).onnx  ## train one network, write it as ONNX: make train MODEL=pair_16 RES=24x32
$(TRAINED): $D/70_train/$(RES1)/%.onnx: $D/60_dataset/$(RES1)/dataset.json $P/models/%.json $P/train.json $(LEARNT_WITH)
$(TUNED:%=$D/70_train/$(RES1)/%.onnx): $(SHIPPED).safetensors $(SHIPPED).onnx

# 80: errors of a network, and its model card; also of the shipped network, on a dataset that it was not trained on.
network_of = $(if $(filter shipped,$1),$(SHIPPED),$D/70_train/$(RES1)/$1).onnx
EVALUATED := $(patsubst %,$D/80_evaluate/$(RES1)/%.json,$(MODELS) shipped)
evaluate: possible $D/80_evaluate/$(RES1)/$(NET).json $D/80_evaluate/$(RES1)/$(NET).card.md  ## errors of one network against labels, baselines and force sensors; its card
$(EVALUATED): $D/80_evaluate/$(RES1)/%.json: $$(call network_of,$$*) $D/60_dataset/$(RES1)/dataset.json $P/evaluate.json
$(EVALUATED:.json=.card.md): %.card.md: $$(call network_of,$$(*F)) %.json $P/card.json

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
report: possible $(REPORT)  ## one HTML page: presses, labels, errors, posterior, chart, failures
$(REPORT): $(PARAMETERS:%=$P/%.json) $(wildcard results/readme/exact.png) $(ROWS) $(USED) $(PICTURES) $(SOLVED) $(FOLLOWED) $(JUDGED) $(SHOWN)

demo: report  ## the whole flow on the demo dataset, from its log to a report
	@echo "open $(REPORT) in a browser: presses, labels, the posterior, networks, and what failed"
