# Set-up: a virtual environment from exact versions, and CalculiX. Choices on the command line are checked before make
# uses them.
PY := .venv/bin/python

# flow/refuse.py reads the command line of this make, refuses what cannot be done, and prints words: NAME=WORD for
# each choice, and `plan` if a dataset is needed. Text that passes it needs no quoting except for blanks.
ANSWER := $(shell exec env PYTHONPATH=src $(if $(wildcard $(PY)),$(PY) -S -P,python3 -S -P) -m gelforge.flow.refuse)
$(if $(filter-out 0,$(.SHELLSTATUS)),$(error $(or $(ANSWER),Python 3.11 or newer is needed as python3)))
answered = $(patsubst $1=%,%,$(filter $1=%,$(ANSWER)))

# What a user may set: make DATASET=mylab RES="24x32 48x64" labels. Training, evaluation and report take the first
# resolution.
DATASET := $(call answered,DATASET)
RES := $(call answered,RES)
RES1 := $(firstword $(RES))
EXECUTOR := $(call answered,EXECUTOR)
JOBS := $(call answered,JOBS)

# The code of this checkout, even if the environment was made in another one.
export PYTHONPATH := $(CURDIR)/src
# Files of this folder named like modules of the standard library, such as types.py, must not shadow them.
export PYTHONSAFEPATH := 1
# Tests are imported from this folder.
PY_HERE := PYTHONSAFEPATH= $(PY)
# The file of gels, for all processes of this make; and the run of make that a finished target belongs to.
export GELFORGE_GELS := $(CURDIR)/workflow/gels.toml
export GELFORGE_RUN := $(call answered,RUN)
# One solver thread per job: make's slots are the parallelism.
export OMP_NUM_THREADS ?= 1
export MKL_NUM_THREADS ?= 1
export OPENBLAS_NUM_THREADS ?= 1

SETUP := .venv/ready
CCX_FOUND := .venv/ccx.path
# A linked environment belongs to another checkout: it is used as it is and never outdated.
VENV_IS_LINK := $(filter-out $(CURDIR)/.venv,$(realpath .venv))
# An environment contains its absolute path: in a moved or copied clone its programs would start in the old place.
VENV_CFG := $(if $(VENV_IS_LINK),,$(wildcard .venv/pyvenv.cfg))
VENV_HOME := $(if $(VENV_CFG),$(shell sed -n 's/^command = .* -m venv \(--[^ ]* \)*//p' $(VENV_CFG)))
ifneq ($(or $(VENV_HOME),$(CURDIR)/.venv),$(CURDIR)/.venv)
$(error .venv was made for $(VENV_HOME), not for this folder: it was moved or copied. \
    Run `rm -rf .venv && make setup`)
endif

setup: $(SETUP) $(CCX_FOUND)  ## virtual environment and CalculiX, inside the project; only system packages go outside

$(SETUP): $(if $(VENV_IS_LINK),,envs/requirements.lock pyproject.toml envs/venv.sh)
	@envs/venv.sh $@

$(CCX_FOUND): envs/ccx.sh | $(SETUP)
	@envs/ccx.sh $@
