# gelforge: raw CNC logs to contact-force labels and networks. `make help` lists the targets.
MAKEFLAGS += -rR --warn-undefined-variables
.SUFFIXES:
.DELETE_ON_ERROR:
SHELL := bash
.SHELLFLAGS := -euo pipefail -c
.DEFAULT_GOAL := help

# The environment, the dataset's plan, and how recipes run; then stages, branches, tools and tests.
include rules/setup.mk
include rules/plan.mk
include rules/run.mk
include rules/flow.mk
include rules/branches.mk
include rules/tools.mk
include rules/test.mk

.PHONY: help
help:  ## this list
	@echo 'make TARGET [DATASET=$(DATASET)] [RES="$(RES)"] [MODEL=NAME] [JOBS=n] [EXECUTOR=local|slurm] [SLURM_PROFILE=FILE.toml] [SOLVES=folder]'
	@sed -nE 's/^([a-z][a-zA-Z0-9_-]*):.*  ## (.*)/  \1\t\2/p' Makefile rules/*.mk | expand -t 24
