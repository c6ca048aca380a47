# Stage 15: whether the images of the log, taken together, show what its rows describe. Nothing is solved before.
IMAGES_JUDGED := $(if $(wildcard $(DATA)/labels),,$D/15_images/images.json)

.PHONY: images
images: $(IMAGES_JUDGED)  ## compare the images of the log with its poses and no-contact images

images_of = gelforge.stages.images --poses $D/10_poses --shards $D/00_plan/shards --params $P/images.json --data $(DATA) \
    $(if $(filter local,$(EXECUTOR)),--jobs $(SLOTS)) --out $@.part

$D/15_images/images.json: $(POSES) $P/images.json $P/gels.json $D/00_plan/nocontact.json | $(call barrier,10_poses)
	$(HANDS_SLOTS)$(call step,$(images_of))
