# Tools for a dataset, for recordings and for the virtual rig. Text from the command line is quoted.
# 141: what reads the output, as in `make status | head`, has closed it.
.PHONY: status
status: | $(SETUP)  ## samples done, failed with reasons and pending, per stage
	@$(PY) -m gelforge.commands.status $D || [ $$? = 141 ]

.PHONY: sample
sample: $(MESHED) $(FOLLOWED) | $(SETUP)  ## run one sample through all stages and show its log: make sample ID=…
	@$(PY) -m gelforge.commands.sample $D --id '$(value ID)' --resolution $(RES1)

.PHONY: provenance
provenance: | $(SETUP)  ## every file, parameter and cost behind one label: make provenance ID=…
	@$(PY) -m gelforge.commands.provenance $D --id '$(value ID)' --resolution $(RES1)

.PHONY: deck
deck: | $(SETUP)  ## CalculiX' deck of one sample, written again from its solve: make deck ID=…
	@$(PY) -m gelforge.commands.deck $D --id '$(value ID)'

.PHONY: look
look: | $(SETUP)  ## pictures of one sample, its gel (.vtu) and its indenter (.stl): make look ID=… RES="24x32 48x64"
	@$(PY) -m gelforge.commands.look --data $(DATA) --results $D --sensors $P/sensors.json --id '$(value ID)' --resolution $(RES)

.PHONY: estimate
estimate: | $(SETUP)  ## core hours, disk and time of make report (labels and calibrate for a log without images) before it starts
	@$(PY) -m gelforge.commands.estimate $D --resolution $(RES1) --model $(NET) --cores $(SLOTS)

# Removes the folder, logs and metrics of a stage.
clean-%:
	@$(if $(wildcard $D/[0-9][0-9]_$* $D/$*),rm -rf $(foreach of,$D $D/logs $D/metrics,$(wildcard $(of)/[0-9][0-9]_$*) $(of)/$*),echo \
	    "$D: has no results of a stage $*")

.PHONY: docs
docs: $(CHECKS)  ## the guide and the Python interface as a site: build/docs/index.html
	@$(PY) -m mkdocs build --strict --quiet
	@echo build/docs/index.html

.PHONY: clean-STAGE
clean-STAGE:  ## remove a stage's artifacts, logs and metrics (clean-fea, clean-labels …)
	@echo "STAGE is the name of a stage or branch, such as fea"

.PHONY: clean-all
clean-all:  ## remove all results of this dataset
	rm -rf $D

# -- import and export

.PHONY: export
export: possible $D/60_dataset/$(RES1)/dataset.json | $(FORMATS)  ## export the dataset: FORMAT=mcap, lerobot or hdf5
	@$(PY) -m gelforge.commands.export --data $(DATA) --dataset $D/60_dataset/$(RES1) --sensors $P/sensors.json --format '$(value FORMAT)'

.PHONY: mcap-import
mcap-import: $(FORMATS)  ## import recordings as images with total force: make mcap-import FROM=folder TOPICS=topics.toml
	@$(PY) -m gelforge.commands.mcap --from '$(value FROM)' --topics '$(value TOPICS)' --data $(DATA)

EXPORTED := $(RES:%=$D/feats/%/normalization_gelforge.npy)

.PHONY: feats-fetch
feats-fetch: $(FORMATS)  ## import FEATS' published dataset to data/feats, all of it or SPLIT="train val", from the hub or a copy FROM=folder
	@$(PY) -m gelforge.commands.feats fetch --from '$(value FROM)' --split '$(value SPLIT)' --downloads downloads/feats --data $(DATA)

.PHONY: feats-import
feats-import: $(SETUP)  ## import FEATS' .npy files: make feats-import FROM=folder DATASET=name SENSOR=name
	@$(PY) -m gelforge.commands.feats import --from '$(value FROM)' --data $(DATA) --sensor '$(or $(value SENSOR),feats_mini)'

.PHONY: feats-export
feats-export: possible $(EXPORTED)  ## write labels in FEATS' layout, with its normalisation file

$(EXPORTED): $D/feats/%/normalization_gelforge.npy: $D/60_dataset/%/dataset.json

.PHONY: projection
projection: $(SETUP)  ## fit a sensor: make projection SENSOR=name POINTS=points.csv and/or IMAGE=nocontact.png
	@$(PY) -m gelforge.commands.projection --sensor '$(value SENSOR)' --like '$(or $(value LIKE),gelsight_mini)' \
	    $(if $(value POINTS),--points '$(value POINTS)') $(if $(value IMAGE),--image '$(value IMAGE)')

# -- the virtual rig writes data/DATASET by a plan, resumes where it stopped, and appends presses when a plan grows.
# Images that were removed, for example to give sensors another appearance, are drawn again from kept surfaces.
.PHONY: rig
rig: $(SETUP)  ## simulate the presses of a plan, write them to data/: make rig PLAN=workflow/rig/train.toml
	@$(PY) -m gelforge.stages.rig --plan '$(or $(value PLAN),workflow/rig/demo.toml)' --data data --jobs $(SLOTS)

# The folder of real images, if it is not GELFORGE_REFERENCE of the environment (tests/support/figures.py).
AT_REFERENCE = $(if $(value REFERENCE),--reference '$(value REFERENCE)')

.PHONY: rig-check
rig-check: $(CHECKS)  ## run benchmark-rig; images of the rig beside real ones: results/rig-check/index.html
	@$(PY_HERE) -m tests.benchmarks.rig $(AT_REFERENCE) --page results/rig-check/index.html

# Pictures of the README and the guide. `make lint` fails if the data of press.png or real.png changed after it was
# drawn.
README_PICTURES := $(addprefix results/readme/,press.png real.png exact.png)

.PHONY: readme-pictures
readme-pictures: $(README_PICTURES)  ## draw the pictures of README and guide: a press, real images beside force maps, charts

# Only on demand: a report shows exact.png as it is.
ifneq ($(filter readme-pictures,$(GOALS)),)
results/readme/press.png: workflow/indenters.toml workflow/rig/sensors.toml
results/readme/real.png: $(SHIPPED).onnx
results/readme/exact.png: results/benchmarks/exact.json
$(README_PICTURES): results/readme/%.png: | $(CHECKS)
	@$(PY_HERE) -m tests.lint.readme_pictures $* --data $^ $(AT_REFERENCE) --out $@
endif
