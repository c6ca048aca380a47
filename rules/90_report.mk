# Stage 90: one page for people.
REPORT := $D/90_report/index.html
# Branches that this dataset's report shows ([report] branches).
CALIBRATION := $(if $(filter calibrate,$(BRANCHES)),$D/calibrate/summary.json)
CHART := $(if $(filter pareto,$(BRANCHES)),$D/pareto/quick.json)

# Branches that were made without being asked for are shown too.
ALSO := $(filter-out $(CALIBRATION) $(CHART),$(wildcard $D/calibrate/summary.json $D/pareto/pareto.json $D/pareto/quick.json))

# What was solved here. A dataset with imported labels is not: of its log, which may know no pose, nothing is solved for a page.
SOLVED := $(if $(IMPORTED),,$(POSES) $(FORCES) $D/50_labels/$(RES1)/labels.json)

.PHONY: report
report: $(REPORT)  ## one HTML page: presses, labels, errors, posterior, chart, failures

report_of = gelforge.stages.report --data $(DATA) --results $D --resolution $(RES1) --model $(MODEL) --params $< \
    --out $@.part

# The page prints the parameters of every stage; the plan writes them before make reads these rules for good.
$(REPORT): $P/report.json $(wildcard $P/*.json) $(SOLVED) $(IS_FROZEN) $D/80_evaluate/$(RES1)/$(MODEL).json \
    $(CALIBRATION) $(CHART) $(ALSO)
	$(call step,$(report_of))
