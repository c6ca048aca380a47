# Stage 10: raw log rows to checked poses and posed surfaces.
POSES := $(SHARDS:%=$D/10_poses/%.csv)

.PHONY: poses
poses: $(POSES) $(call barrier,10_poses)  ## check the log, place every indenter's surface as the CNC did

$(POSES): $D/10_poses/%.csv: $D/00_plan/shards/%.csv $D/00_plan/shards/%.json $P/poses.json
	$(call step,gelforge.stages.poses --data $(DATA) --shard $< --params $P/poses.json $(if $(STRICT),--strict) --out $@.part)

# STRICT=1 after a make without it: shards that rejected a row, or hold a picture of two presses, are judged again, and fail.
.PHONY: strict
REJECTING := $(if $(STRICT),$(shell find $D/10_poses -maxdepth 1 -name '*.rejected.csv' -exec awk 'FNR == 2 {print FILENAME}' {} + 2>/dev/null))
$(REJECTING:%.rejected.csv=%.csv): strict
REPEATING := $(if $(STRICT),$(shell grep -rls --include='*.json' '^ "repeated": {' $D/00_plan/shards))
$(REPEATING:$D/00_plan/shards/%.json=$D/10_poses/%.csv): strict
