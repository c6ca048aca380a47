REPORT := $D/90_report/index.html
# What this dataset's report shows of branches ([report] branches), and those that were made without being asked for.
SHOWN := $(sort $(BRANCHES:%=$D/%) $(wildcard $D/calibrate/summary.json $D/pareto/pareto.json))
# What was solved here. A dataset with imported labels is not: of its log, which may know no pose, nothing is solved.
SOLVED := $(if $(IMPORTED),,$(POSES) $(FORCES) $D/50_labels/$(RES1)/labels.json)

report: $(REPORT)  ## one HTML page: presses, labels, errors, posterior, chart, failures

# The page prints the parameters of every stage; the plan writes them before make reads these rules for good.
$(REPORT): $P/report.json $(wildcard $P/*.json) $(SOLVED) $(IS_FROZEN) $D/80_evaluate/$(RES1)/$(MODEL).json $(SHOWN)
	$(call step,gelforge.stages.report $D $(RES1) $(MODEL))
