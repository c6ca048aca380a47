# Pictures of the README and the guide. `make lint` fails where press.png or real.png is older than what it shows.
README_PICTURES := $(addprefix results/readme/,press.png real.png speed.png stability.png exact.png)

readme-pictures: $(README_PICTURES)  ## draw the pictures of README and guide: a press, real images beside force maps, charts

results/readme/press.png: workflow/indenters.toml workflow/rig/sensors.toml
results/readme/real.png: src/gelforge/reading/weights/default.onnx
results/readme/speed.png: $D/pareto/pareto.json
results/readme/exact.png: results/benchmarks/exact.json
results/readme/stability.png: $D/stability/map.json
$(README_PICTURES): results/readme/%.png: | $(SETUP)
	@$(PY_HERE) -m tests.benchmarks.readme_pictures $* --data $^ $(AT_REFERENCE) --out $@
