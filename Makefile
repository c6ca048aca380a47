# gelforge: raw CNC logs to contact-force labels and networks. `make help` lists the targets.
MAKEFLAGS += -rR --warn-undefined-variables
# What people and their shells give is text, whatever variable it comes in: make must not expand $(shell …) inside it.
by_others = $(filter command environment,$(firstword $(origin $1)))
as_text = $(if $(call by_others,$1),$(if $(findstring $$,$(value $1)),$(eval override $1 := $$(value $1))))
$(foreach v,$(filter-out MAKE% MFLAGS SHELL -%,$(.VARIABLES)),$(call as_text,$v))
.SUFFIXES:
.DELETE_ON_ERROR:
SHELL := bash
.SHELLFLAGS := -euo pipefail -c
.DEFAULT_GOAL := help

# What a user may set: make DATASET=mylab RES="24x32 48x64" labels. The plan chooses MODEL where nobody does.
DATASET ?= demo
RES ?= 24x32
# Training, evaluation and the report take the first resolution.
RES1 = $(firstword $(RES))
EXECUTOR ?= local
# nproc would give the number that a shell grants to one program's threads, where it sets these.
JOBS ?= $(shell env -u OMP_NUM_THREADS -u OMP_THREAD_LIMIT nproc)

# $(call given,NAME) is a variable's text as one quoted word of a shell command: nothing in it is expanded.
define NEWLINE


endef
given = '$(subst $(NEWLINE), ,$(subst ','\'',$(value $(1))))'
# Defaults that make works out are no text of others.
by_hand = $(filter command environment override,$(firstword $(origin $(1))))
# Those of some variables that a person gave, as words NAME=TEXT.
if_given = $(foreach v,$1,$(if $(call by_hand,$v),$v=$(call given,$v)))

include rules/00_setup.mk
include rules/00_plan.mk
include rules/10_poses.mk
include rules/15_images.mk
include rules/20_meshes.mk
include rules/30_fea.mk
include rules/40_forces.mk
include rules/50_labels.mk
include rules/60_dataset.mk
include rules/70_train.mk
include rules/80_evaluate.mk
include rules/90_report.mk
# Branches, and what people ask for: the order of these does not matter.
include rules/calibrate.mk
include rules/export.mk
include rules/feats.mk
include rules/look.mk
include rules/pareto.mk
include rules/pareto_models.mk
include rules/projection.mk
include rules/rig.mk
include rules/showcase.mk
include rules/stability.mk
include rules/test.mk
include rules/work.mk

# Results that must be made again whatever their dates (flow/asked.py).
$(DUE): due

# What `make help` lists is no file.
.PHONY: $(shell sed -nE 's/^([a-z][a-zA-Z0-9_-]*):.*  ## .*/\1/p' Makefile rules/*.mk)

help:  ## this list
	@echo 'make TARGET [DATASET=$(DATASET)] [RES="$(RES)"] [MODEL=NAME] [JOBS=n]' \
	    '[EXECUTOR=local|slurm] [SLURM_PROFILE=FILE.toml]'
	@sed -nE 's/^([a-z][a-zA-Z0-9_-]*):.*  ## (.*)/  \1\t\2/p' Makefile rules/*.mk | expand -t 24
