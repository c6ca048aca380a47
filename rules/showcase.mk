# Pictures of the README. `make lint` fails where press.png or real.png is older than what it shows.
README := results/readme
README_FILMS := cheese_tube_3_camera_0.avi tin_box_2_camera_2.avi wooden_statue_5_camera_2.avi
README_FLAGGED := ball_white_thread_9_camera_2.avi
FILM = $(call given,REFERENCE)/gripper_videos/$(1)
FILMS = $(foreach film,$(README_FILMS),$(call FILM,$(film))) --flagged $(call FILM,$(README_FLAGGED))
README_PICTURES := $(README)/press.png $(README)/real.png $(README)/speed.png $(README)/stability.png

.PHONY: readme-pictures
readme-pictures: $(README_PICTURES)  ## draw the README's pictures: a press, real images beside force maps, charts

$(README)/press.png: workflow/indenters.toml workflow/rig/sensors.toml | $(SETUP)
	@$(PY_HERE) -m tests.benchmarks.readme_pictures press --catalogue $< --name triangle_10 --rig workflow/rig --out $@

$(README)/real.png: src/gelforge/networks/weights/default.onnx | $(SETUP)
	@$(PY_HERE) -m tests.benchmarks.readme_pictures real $(FILMS) --out $@

$(README)/speed.png: $D/pareto/pareto.json
	@$(PY_HERE) -m tests.benchmarks.readme_pictures copy --chart $D/pareto/pareto.png --data $< --out $@

$(README)/stability.png: $D/stability/map.json
	@$(PY_HERE) -m tests.benchmarks.readme_pictures copy --chart $D/stability/map.png --data $< --out $@
