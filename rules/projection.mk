# A sensor's projection from point correspondences, or from the markers of an image without contact.
POINTS ?=
IMAGE ?=
LIKE ?= gelsight_mini

.PHONY: projection
projection: $(SETUP)  ## fit a sensor: make projection SENSOR=name POINTS=points.csv and/or IMAGE=nocontact.png
	@$(PY) -m gelforge.commands.projection --sensor $(call given,SENSOR) --like $(call given,LIKE) \
	    $(if $(POINTS),--points $(call given,POINTS)) $(if $(IMAGE),--image $(call given,IMAGE))
