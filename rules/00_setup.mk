# Set-up: a virtual environment from exact versions, and CalculiX.
PY := .venv/bin/python
# The code of this checkout, whichever one the environment was made in.
export PYTHONPATH := $(CURDIR)/src
# A file of this folder that is named like a module of Python's own, such as types.py, does not take its place.
export PYTHONSAFEPATH := 1
# Tests are imported from this folder.
PY_HERE := PYTHONSAFEPATH= $(PY)
# Gels of one's own, for all processes of this make.
export GELFORGE_GELS := $(CURDIR)/workflow/gels.toml
SETUP := .venv/ready
# A linked environment is another checkout's: it is used as it is, and nothing here makes it out of date.
VENV_IS_LINK := $(filter-out $(CURDIR)/.venv,$(realpath .venv))
# An environment knows the place it was made in: in a clone that was moved or copied its programs start elsewhere.
VENV_CFG := $(if $(VENV_IS_LINK),,$(wildcard .venv/pyvenv.cfg))
VENV_HOME := $(if $(VENV_CFG),$(shell sed -n 's/^command = .* -m venv \(--[^ ]* \)*//p' $(VENV_CFG)))
ifneq ($(or $(VENV_HOME),$(CURDIR)/.venv),$(CURDIR)/.venv)
$(error .venv was made for $(VENV_HOME), not for this folder: it was moved or copied. \
    Run `rm -rf .venv && make setup`)
endif
CCX_FOUND := .venv/ccx.path

# One solver thread per job: make's slots are the parallelism.
export OMP_NUM_THREADS ?= 1
export MKL_NUM_THREADS ?= 1
export OPENBLAS_NUM_THREADS ?= 1

# Jobs default to the cores of the machine; -jN on the command line wins. A make below this one shares its slots.
ifeq ($(value HAS_SLOTS)$(filter -j%,$(MAKEFLAGS)),)
MAKEFLAGS += -j$(JOBS)
endif
# Jobs of a program that runs several at a time by itself. Known when a recipe is expanded, not before.
SLOTS = $(or $(patsubst -j%,%,$(filter -j%,$(MAKEFLAGS))),$(JOBS))
# What of -n, -q and -t make was given, under which nothing is done.
ONLY_SHOWN = $(strip $(foreach f,n q t,$(findstring $f,$(firstword -$(MAKEFLAGS)))))
# Before the recipe of such a program: it then takes slots that are free (flow/slots.py).
HANDS_SLOTS = $(if $(ONLY_SHOWN),,+)

setup: $(SETUP) $(CCX_FOUND)  ## virtual environment and CalculiX, inside the project; only system packages go outside

$(SETUP): $(if $(VENV_IS_LINK),,envs/requirements.lock pyproject.toml envs/venv.sh)
	@envs/venv.sh $@

$(CCX_FOUND): envs/ccx.sh | $(SETUP)
	@envs/ccx.sh $@
