LIKE ?= gelsight_mini

projection: $(SETUP)  ## fit a sensor: make projection SENSOR=name POINTS=points.csv and/or IMAGE=nocontact.png
	@$(PY) -m gelforge.commands.projection --sensor $(call given,SENSOR) --like $(call given,LIKE) \
	    $(if $(value POINTS),--points $(call given,POINTS)) $(if $(value IMAGE),--image $(call given,IMAGE))
