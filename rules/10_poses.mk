POSES := $(SHARDS:%=$D/10_poses/%.csv)

poses: $(POSES) $(call barrier,10_poses)  ## check the log, place every indenter's surface as the CNC did

$(POSES): $D/10_poses/%.csv: $D/00_plan/shards/%.csv $D/00_plan/shards/%.json $P/poses.json
	$(call step,gelforge.stages.poses $D $*)
