look:  ## pictures of one sample, its gel (.vtu) and its indenter (.stl): make look ID=… RES="24x32 48x64"
	@$(PY) -m gelforge.commands.look --data $(DATA) --results $D --sensors $P/sensors.json \
	    --id $(call given,ID) --resolution $(RES)
