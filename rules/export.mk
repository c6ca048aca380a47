# A dataset in formats that others read: make export FORMAT=lerobot.
FORMAT ?=
SUFFIX_mcap := .mcap
SUFFIX_rerun := .rrd
SUFFIX_lerobot :=
SUFFIX_webdataset :=
SUFFIX_hdf5 := .h5
EXPORT = $D/export/$(RES1)/$(FORMAT)/$(DATASET)$(SUFFIX_$(FORMAT))

.PHONY: export
export: $D/60_dataset/$(RES1)/dataset.json  ## write a dataset in another format: make export FORMAT=mcap, rerun, lerobot, webdataset or hdf5
	@$(PY) -m gelforge.commands.export --data $(DATA) --dataset $(<D) --sensors $P/sensors.json --format $(FORMAT) --out $(EXPORT)

# The other way: recordings in MCAP become a dataset of pictures with total force.
TOPICS ?=

.PHONY: mcap-import
mcap-import: $(SETUP)  ## import MCAP recordings to data/DATASET: make mcap-import FROM=folder TOPICS=topics.toml DATASET=name
	@$(PY) -m gelforge.commands.mcap --from $(call given,FROM) --topics $(call given,TOPICS) --data $(DATA)
