# Pictures of the README. `make lint` fails where press.png or real.png is older than what it shows.
README := results/readme
README_FILMS := ball_white_thread_4_camera_0.avi glass_box_1_camera_2.avi marker_pen_1_camera_0.avi
FILMS = $(foreach film,$(README_FILMS),$(call given,REFERENCE)/gripper_videos/$(film))
README_PICTURES := $(README)/press.png $(README)/real.png $(README)/speed.png $(README)/stability.png

.PHONY: readme-pictures
readme-pictures: $(README_PICTURES)  ## draw the README's pictures: a press, real images beside force maps, charts

$(README)/press.png: workflow/indenters.toml | $(SETUP)
	@$(PY_HERE) -m tests.benchmarks.readme_pictures press --catalogue $< --name triangle_10 --out $@

$(README)/real.png: src/gelforge/networks/weights/default.onnx | $(SETUP)
	@$(PY_HERE) -m tests.benchmarks.readme_pictures real $(FILMS) --out $@

$(README)/speed.png: $D/pareto/pareto.json
	@$(PY_HERE) -m tests.benchmarks.readme_pictures copy --chart $D/pareto/pareto.png --data $< --out $@

$(README)/stability.png: $D/stability/map.json
	@$(PY_HERE) -m tests.benchmarks.readme_pictures copy --chart $D/stability/map.png --data $< --out $@
