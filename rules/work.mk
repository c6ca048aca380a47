demo:  ## the whole flow on the demo dataset: labels, predictions of the shipped network, calibration, chart, report
demo: $(if $(IS_FROZEN),report)
	$(if $(IS_FROZEN),,@export HAS_SLOTS=yes; $(MAKE) --no-print-directory freeze && $(MAKE) --no-print-directory report)
	@echo "report: $D/90_report/index.html"

status: | $(SETUP)  ## samples done, failed with reasons and pending, per stage
	@$(PY) -m gelforge.commands.status $D $(if $(MODELS),--meshes $(MESHES))

sample: | $(SETUP)  ## run one sample through all stages and show its log: make sample ID=…
	@$(PY) -m gelforge.commands.sample $D --id $(call given,ID) --resolution $(RES1)

STAGES := poses:10_poses images:15_images meshes:20_meshes fea:30_fea forces:40_forces labels:50_labels \
    dataset:60_dataset train:70_train evaluate:80_evaluate report:90_report calibrate:calibrate pareto:pareto \
    stability:stability pareto_models:pareto_models
CLEAN := $(foreach s,$(STAGES),clean-$(firstword $(subst :, ,$s)))

.PHONY: $(CLEAN)
$(CLEAN): clean-%:
	rm -rf $(addprefix $D/,$(foreach k,. logs metrics,$k/$(patsubst $*:%,%,$(filter $*:%,$(STAGES)))))

clean-STAGE:  ## remove a stage's artifacts, logs and metrics (clean-fea, clean-labels …)
	@echo "one of: $(CLEAN)"

clean-all:  ## remove all results of this dataset
	rm -rf $D

provenance: | $(SETUP)  ## every file, parameter and cost behind one label: make provenance ID=…
	@$(PY) -m gelforge.commands.provenance $D --id $(call given,ID) --resolution $(RES1)

# Meshes that the pilots need are made, and the run finds them.
estimate: | $(SETUP)  ## core hours, disk and time of make report, or of what a log without images has, before it starts
	@$(PY) -m gelforge.commands.estimate $D --resolution $(RES1) --model $(MODEL) --cores $(SLOTS)
