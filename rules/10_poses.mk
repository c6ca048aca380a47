# Stage 10: raw log rows to checked poses and posed surfaces.
POSES := $(SHARDS:%=$D/10_poses/%.csv)

.PHONY: poses
poses: $(POSES) $(call barrier,10_poses)  ## check the log, place every indenter's surface as the CNC did

# $(call poses_of,FOLDER,SHARD) makes a shard's file, $(call meshes_of,…) and so on the next ones: `make sample` and `make
# estimate` run the same on a shard and in a folder of their own.
poses_of = gelforge.stages.poses --data $(DATA) --shard $1/00_plan/shards/$2.csv --params $P/poses.json \
    --out $1/10_poses/$2.csv

$(POSES): $D/10_poses/%.csv: $D/00_plan/shards/%.csv $D/00_plan/shards/%.json $P/poses.json
	$(call step,$(call poses_of,$D,$*).part $(if $(STRICT),--strict))
