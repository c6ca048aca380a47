# Set-up: a virtual environment from exact versions, and CalculiX; and what a user may set on the command line.
PY := .venv/bin/python

# make DATASET=mylab RES="24x32 48x64" labels. Training, evaluation and report take the first resolution. Values come
# from the command line alone: the environment and a misspelt name would change results without a word.
CHOICES := DATASET RES MODEL EXECUTOR JOBS SOLVES ID FORMAT SENSOR LIKE FROM TOPICS SPLIT PLAN POINTS IMAGE REFERENCE TESTS \
    MARKED SLURM_PROFILE
$(foreach v,$(CHOICES),$(eval $v :=))
GOALS := $(or $(MAKECMDGOALS),help)
DATASET := $(if $(filter feats-fetch,$(GOALS)),feats,demo)
RES := 24x32
EXECUTOR := local
JOBS := $(shell env -u OMP_NUM_THREADS -u OMP_THREAD_LIMIT nproc)
SOLVES := results/solves

# $(call refuse,WORDS,TEXT) ends make with the text if there are words.
refuse = $(if $(strip $1),$(error $2))
comma := ,
GIVEN := $(foreach v,$(.VARIABLES),$(if $(filter command,$(firstword $(origin $v))),$v))
UNKNOWN := $(filter-out $(CHOICES) -%,$(GIVEN))
$(call refuse,$(UNKNOWN),$(firstword $(UNKNOWN))=$(value $(firstword $(UNKNOWN))): no such choice; there are $(CHOICES))

# Those of -n, -q and -t that make was given: it then runs nothing.
ONLY_SHOWN := $(strip $(foreach f,n q t,$(findstring $f,$(firstword -$(MAKEFLAGS)))))

# Names become folders and words of a shell: `odd` is what is left of a choice's text without the characters allowed.
DIGITS := 0 1 2 3 4 5 6 7 8 9
LETTERS := a b c d e f g h i j k l m n o p q r s t u v w x y z A B C D E F G H I J K L M N O P Q R S T U V W X Y Z _ - . $(DIGITS)
left = $(if $2,$(call left,$(subst $(firstword $2),,$1),$(wordlist 2,$(words $2),$2)),$1)
odd = $(strip $(if $(strip $(value $1)),$(call left,$(value $1),$2),empty))
# A text with one of these would be code for make or for the shell; make expands what it hands to its commands.
$(foreach v,$(CHOICES),$(foreach c,' " ` \ $$,$(call refuse,$(findstring $c,$(value $v)),$v=$(value $v): give text without $c)))
$(foreach v,DATASET EXECUTOR $(if $(MODEL),MODEL) $(if $(FORMAT),FORMAT),$(call refuse,$(call odd,$v,$(LETTERS))$(filter . .. -%,$(value $v)),$v=$(value $v): give one name of \
    letters, digits, _ - and .))
misshapen = $(strip $(foreach r,$(RES),$(if $(filter 0%,$(subst x, ,$r))$(findstring xx,$r)$(filter-out 2,$(words $(subst x, ,$r))),$r)))
$(call refuse,$(call odd,RES,$(DIGITS) x)$(misshapen),RES=$(value RES): give resolutions as ROWSxCOLUMNS, such as RES="12x16 24x32")
RES1 := $(firstword $(RES))
$(call refuse,$(call odd,JOBS,$(DIGITS)),JOBS=$(value JOBS): give a number of jobs)
$(call refuse,$(filter-out local slurm,$(EXECUTOR)),EXECUTOR=$(EXECUTOR): give local or slurm)
$(call refuse,$(filter benchmarks readme solves,$(DATASET)),DATASET=$(DATASET): results/$(DATASET) holds no dataset; name a folder of data/)
$(call refuse,$(and $(filter clean-%,$(GOALS)),$(filter-out clean-%,$(GOALS))),clean together with another goal: say make \
    $(filter clean-%,$(GOALS)) first$(comma) then make $(filter-out clean-%,$(GOALS)))

# The code of this checkout, even if the environment was made in another one.
export PYTHONPATH := $(CURDIR)/src
# Files of this folder named like modules of the standard library, such as types.py, must not shadow them.
export PYTHONSAFEPATH := 1
# Packages come without compiled modules: without the ones that Python then keeps, each start of it takes a second more.
unexport PYTHONDONTWRITEBYTECODE
# Tests are imported from this folder.
PY_HERE := PYTHONSAFEPATH= $(PY)
# The file of gels, and the store of solves, for all processes of this make.
export GELFORGE_GELS := $(CURDIR)/workflow/gels.toml
export GELFORGE_SOLVES = $(value SOLVES)
# One solver thread per job: make's slots are the parallelism.
export OMP_NUM_THREADS ?= 1
export MKL_NUM_THREADS ?= 1
export OPENBLAS_NUM_THREADS ?= 1

SETUP := .venv/ready
FORMATS := .venv/formats.ready
CHECKS := .venv/checks.ready
CCX_FOUND := .venv/ccx.path
COMPILED := .venv/kernels.compiled
# A linked environment belongs to another checkout: it is used as it is and never outdated.
VENV_IS_LINK := $(filter-out $(CURDIR)/.venv,$(realpath .venv))
# Nor is any for -n, -q and -t of another goal: make makes what it includes even then, and so would set up.
AS_IT_IS := $(VENV_IS_LINK)$(if $(filter-out setup,$(GOALS)),$(ONLY_SHOWN))
# An environment contains its absolute path: in a moved or copied clone its programs would start in the old place.
VENV_CFG := $(if $(VENV_IS_LINK),,$(wildcard .venv/pyvenv.cfg))
VENV_HOME := $(if $(VENV_CFG),$(shell sed -n 's/^command = .* -m venv \(--[^ ]* \)*//p' $(VENV_CFG)))
$(call refuse,$(filter-out $(CURDIR)/.venv,$(VENV_HOME)),.venv was made for $(VENV_HOME)$(comma) not for this folder: it was moved or copied. \
    Run `rm -rf .venv && make setup`)

.PHONY: setup
setup: $(SETUP) $(CCX_FOUND) $(COMPILED)  ## virtual environment and CalculiX, inside the project; only system packages go outside

$(SETUP): $(if $(AS_IT_IS),,envs/requirements.lock pyproject.toml envs/venv.sh)
	@envs/venv.sh $@ envs/requirements.lock

# Packages that only other formats, and only tests, lint and docs need.
$(FORMATS) $(CHECKS): .venv/%.ready: $(if $(AS_IT_IS),,envs/%.lock) | $(SETUP)
	@envs/venv.sh $@ envs/$*.lock

$(CHECKS): | $(FORMATS)

$(CCX_FOUND): $(if $(AS_IT_IS),,envs/ccx.sh)
	@envs/ccx.sh $@

$(COMPILED): $(if $(AS_IT_IS),,envs/kernels.py) | $(SETUP)
	@$(PY) envs/kernels.py $@
