# Stage 70: networks. A model is a table of workflow/models.toml; RES names the grid.
# MODELS, TUNED and NEED_NOCONTACT come from the plan.
SHIPPED := src/gelforge/networks/weights/default
# The shipped network is never trained here.
LEARNT = $(if $(filter shipped,$(MODEL)),$(LEARNER),$(MODEL))
# Those that fine-tune the shipped network (TUNED) are for one dataset, and write its grid: they are made by name alone.
LEARNABLE := $(filter-out $(TUNED),$(MODELS))
TRAINED := $(MODELS:%=$D/70_train/$(RES1)/%.onnx)

# By hand, a network must be one that there is, and one that learns where it is to learn.
ifneq ($(call by_hand,MODEL),)
ifeq ($(filter $(MODELS) shipped,$(MODEL))$(if $(MODELS),,unknown),)
$(error MODEL=$(MODEL): no such network; workflow/models.toml has: $(MODELS), and shipped is the one that ships)
endif
ifneq ($(and $(filter $(TUNED),$(MODEL)),$(filter-out $(SHIPPED_RES),$(RES1))),)
$(error MODEL=$(MODEL) fine-tunes the shipped network, whose grid is $(SHIPPED_RES): say RES=$(SHIPPED_RES), or name another network)
endif
ifneq ($(and $(filter shipped,$(MODEL)),$(filter train ship,$(MAKECMDGOALS))),)
$(error MODEL=shipped: the shipped network was trained elsewhere; to $(firstword $(filter train ship,$(MAKECMDGOALS))), name one of $(MODELS))
endif
endif

# Networks that read a picture beside a no-contact image. Without such pictures none of them can be judged, which
# is said here, and not after the presses are solved.
WITH_NOCONTACT := shipped $(NEED_NOCONTACT)
ASKED = $(if $(filter evaluate report demo,$(MAKECMDGOALS)),$(MODEL)) $(if $(filter train ship,$(MAKECMDGOALS)),$(LEARNT)) \
    $(if $(filter models evaluate-models,$(MAKECMDGOALS)),$(LEARNABLE)) $(if $(filter pareto-models,$(MAKECMDGOALS)),$(or $(call by_hand,CHARTED),$(LEARNABLE)))
UNREADABLE = $(firstword $(filter $(WITH_NOCONTACT),$(ASKED)))
ifneq ($(and $(wildcard $(DATA)),$(if $(wildcard $(DATA)/nocontact),,no),$(UNREADABLE)),)
$(error MODEL=$(UNREADABLE) reads a picture beside a no-contact image, and $(DATA)/nocontact is missing: add nocontact/SENSOR.png of each sensor, or name a network that reads the image alone, such as grid_16 ([params.report] model in $(DATA)/dataset.toml))
endif

ifneq ($(and $(filter ship,$(MAKECMDGOALS)),$(if $(call by_hand,MODEL),,no)),)
$(error ship: takes the place of the shipped network; name the one that shall, make ship MODEL=… DATASET=…)
endif

ifneq ($(and $(filter ship,$(MAKECMDGOALS)),$(filter-out $(SHIPPED_RES),$(RES1))),)
$(error ship RES=$(RES1): the shipped network has a grid of $(SHIPPED_RES); train one of it, RES=$(SHIPPED_RES))
endif

.PHONY: train models
train: $D/70_train/$(RES1)/$(LEARNT).onnx  ## train one network and export it as ONNX: make train MODEL=grid_16 RES=24x32
models: $(LEARNABLE:%=$D/70_train/$(RES1)/%.onnx)  ## train every network of workflow/models.toml that needs only the dataset

# Other datasets that are learnt from as well ([train] also). They are made by themselves.
LEARNT_WITH := $(LEARN_ALSO:%=results/%/60_dataset/$(RES1)/dataset.json)
$(LEARNT_WITH):
	$(error $@ is missing, and [train] also asks for it: make DATASET=$(word 2,$(subst /, ,$@)) RES=$(RES1) dataset)

$(TRAINED): $D/70_train/$(RES1)/%.onnx: $D/60_dataset/$(RES1)/dataset.json $P/models/%.json $P/train.json $(LEARNT_WITH)
	$(call step,gelforge.stages.train --dataset $(<D) $(if $(LEARNT_WITH),--also $(patsubst %/,%,$(dir $(LEARNT_WITH)))) --model $* --models $P/models/$*.json --params $P/train.json --out $@.part)

$(TUNED:%=$D/70_train/$(RES1)/%.onnx): $(SHIPPED).safetensors
