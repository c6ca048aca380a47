export: $D/60_dataset/$(RES1)/dataset.json  ## write it for others: FORMAT=mcap, rerun, lerobot, webdataset or hdf5
	@$(PY) -m gelforge.commands.export --data $(DATA) --dataset $(<D) --sensors $P/sensors.json \
	    --format $(call given,FORMAT)

mcap-import: $(SETUP)  ## recordings become pictures with total force: make mcap-import FROM=folder TOPICS=topics.toml
	@$(PY) -m gelforge.commands.mcap --from $(call given,FROM) --topics $(call given,TOPICS) --data $(DATA)
