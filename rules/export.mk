# A dataset in formats that others read: make export FORMAT=lerobot.
FORMAT ?=

.PHONY: export
export:  ## write a dataset in another format: make export FORMAT=mcap, rerun, lerobot, webdataset or hdf5
export: $D/60_dataset/$(RES1)/dataset.json
	@$(PY) -m gelforge.commands.export --data $(DATA) --dataset $(<D) --sensors $P/sensors.json --format $(FORMAT)

# The other way: recordings in MCAP become a dataset of pictures with total force.
TOPICS ?=

.PHONY: mcap-import
mcap-import: $(SETUP)  ## import MCAP recordings to data/DATASET: make mcap-import FROM=folder TOPICS=topics.toml
	@$(PY) -m gelforge.commands.mcap --from $(call given,FROM) --topics $(call given,TOPICS) --data $(DATA)
