# Branch study: what a network gains from more presses and from more units. The same network learns from parts of the
# training presses, as many passes over each: make study STUDIED="presses_250 units_4".
STUDIED ?= presses_250 presses_500 presses_1000 units_1 units_4 units_12
WRONG_PARTS := $(strip $(foreach part,$(STUDIED),$(if $(call without,$(patsubst presses_%,%,$(part:units_%=%)),$(DIGITS)),$(part))))
ifneq ($(WRONG_PARTS),)
$(error STUDIED names $(WRONG_PARTS): give presses_N or units_N, such as presses_250)
endif
STUDY := $D/study/$(RES1)/$(LEARNT)
# Networks and their evaluations lie in folders of their own: a log and a record are named by a target without its suffix.
STUDIES := $(STUDIED:%=$(STUDY)/networks/%.onnx)
JUDGED := $(STUDIED:%=$(STUDY)/evaluations/%.json)

.PHONY: study study-with-others
study: $(STUDY)/study.json  ## error of one network against the number of training presses and units, STUDIED="presses_250 units_4": chart, CSV, JSON

# The network of all presses would have learnt from other datasets too, and those of parts from none. A recipe refuses: make
# may have read an old plan, which it makes anew before it runs one.
study-with-others:
	$(error [train] also = $(LEARN_ALSO): a study compares parts of one dataset with all of it, and these others would be in its whole alone; set [params.train] also = [] in $(DATA)/dataset.toml)

$(STUDIES): $(STUDY)/networks/%.onnx: $D/60_dataset/$(RES1)/dataset.json $P/models/$(LEARNT).json $P/train.json
	$(call step,gelforge.stages.train --dataset $(<D) --model $(LEARNT) --part $* --models $P/models/$(LEARNT).json --params $P/train.json --out $@.part)

$(if $(filter $(TUNED),$(LEARNT)),$(STUDIES)): $(SHIPPED).safetensors

$(JUDGED): $(STUDY)/evaluations/%.json: $(STUDY)/networks/%.onnx $D/60_dataset/$(RES1)/dataset.json $P/evaluate.json
	$(call step,gelforge.stages.evaluate --dataset $(dir $(word 2,$^)) --model $< --params $P/evaluate.json --out $@.part)

$(STUDY)/study.json: $(if $(LEARN_ALSO),study-with-others) $D/80_evaluate/$(RES1)/$(LEARNT).json $(JUDGED) $P/study.json $(STUDY)/choice.txt
	$(call step,gelforge.stages.study --whole $< --parts $(JUDGED) --out $@.part)

$(eval $(call choice,$(STUDY)/choice.txt,$(STUDIED)))
