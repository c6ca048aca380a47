# Stage 10: raw log rows to checked poses and posed surfaces.
POSES := $(SHARDS:%=$D/10_poses/%.csv)

.PHONY: poses
poses: $(POSES) $(call barrier,10_poses)  ## check the log, put every indenter's surface where the CNC put it

# Users' own shapes are named from workflow/, so they are prerequisites too.
SHAPES := $(wildcard workflow/*.stl workflow/*/*.stl)

$(POSES): $D/10_poses/%.csv: $D/00_plan/shards/%.csv $P/poses.json $P/indenters.json $P/sensors.json $(SHAPES)
	$(call step,gelforge.stages.poses --data $(DATA) --shard $< --params $P/poses.json $(if $(STRICT),--strict) --out $@.part)
