# Branch calibrate: posterior of C10 and of what the bench does to the measurement, from the log's forces.
# Solves, chain and pictures lie beside the summary, which is published last.
POSTERIOR := $D/calibrate/summary.json

.PHONY: calibrate
calibrate: $(POSTERIOR)  ## posterior of C10, touch offset, compliance and friction from the log's force readings

$(POSTERIOR): $(DATA)/log.csv $P/calibrate.json $P/indenters.json $P/sensors.json $(POSES) | $(call barrier,10_poses)
	$(HANDS_SLOTS)$(call step,gelforge.stages.calibrate --data $(DATA) --poses $D/10_poses --shards $D/00_plan/shards --sensors $P/sensors.json --params $P/calibrate.json --work $D/calibrate $(if $(filter local,$(EXECUTOR)),--jobs $(SLOTS)) --out $@.part)
