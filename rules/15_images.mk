# Stage 15: whether the images of the log, taken together, show what its rows describe. Nothing is solved before. A log
# without images has none to judge.
IMAGES_JUDGED := $(if $(IMPORTED),,$(if $(IMAGES),$D/15_images/images.json))

images: $(IMAGES_JUDGED)  ## compare the images of the log with its poses and no-contact images

$D/15_images/images.json: $(POSES) $P/images.json $P/gels.json $D/00_plan/nocontact.json | $(call barrier,10_poses)
	$(HANDS_SLOTS)$(call step,gelforge.stages.images $D $(IN_SLOTS))
