# Stage 50: labels at every resolution of RES. One process per resolution labels all shards that are out
# of date, because starting one per shard would cost more than the labels; labels.json is written last.
LABELS := $(RES:%=$D/50_labels/%/labels.json)

labels: $(LABELS)  ## force per grid cell: make labels RES="12x16 24x32 48x64"

$(LABELS): $D/50_labels/%/labels.json: $(FORCES) $(POSES) $D/00_plan/shards.csv $P/labels.json $P/sensors.json \
    | $(call barrier,10_poses 40_forces)
	$(call step,gelforge.stages.labels $D $*)
