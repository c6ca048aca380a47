# Branch calibrate: posterior of C10 and of what the bench does to the measurement, from the log's forces.
# Solves, chain and pictures lie beside the summary, which is published last.
POSTERIOR := $D/calibrate/summary.json

calibrate: $(POSTERIOR)  ## posterior of C10, touch offset, compliance and friction from the log's force readings

freeze: $(POSTERIOR)  ## write the posterior to data/DATASET/calibration.toml: labels use it until the next make freeze
	@$(PY) -m gelforge.commands.freeze $D

# Another make reads what was frozen: poses and stiffness of this one are those before.
calibrated-labels: $(if $(IS_FROZEN),labels)  ## calibrate by the log's forces, freeze the result, make labels with it
	$(if $(IS_FROZEN),@:,@export HAS_SLOTS=yes; $(MAKE) --no-print-directory freeze && $(MAKE) --no-print-directory labels)

# It reads the path as commanded: poses that a frozen calibration moved make it no other.
$(POSTERIOR): $(DATA)/log.csv $P/calibrate.json $P/indenters.json $P/sensors.json $P/gels.json \
    | $(POSES) $(call barrier,10_poses)
	$(HANDS_SLOTS)$(call step,gelforge.stages.calibrate $D $(IN_SLOTS))
