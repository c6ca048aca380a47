# Tests, and benchmarks against goals.
# A test process that dies is not restarted, because the others would wait for it forever.
PYTEST = $(PY_HERE) -m pytest -n $(SLOTS) --dist worksteal --max-worker-restart=0 --durations=20

# A browser for tests of pages, Slurm for a cluster of one node; installed one after the other, because apt has one
# lock.
CHROMIUM_FOUND := .venv/chromium.found
SLURM_FOUND := .venv/slurm.found

$(SLURM_FOUND): | $(CHROMIUM_FOUND)
$(CHROMIUM_FOUND) $(SLURM_FOUND): .venv/%.found: envs/%.sh | $(CCX_FOUND)
	@envs/$*.sh $@

test benchmark-face: $(CHROMIUM_FOUND)
test-all benchmark-slurm: $(SLURM_FOUND)

# LeRobot's package needs other versions than ours. Downloads take minutes, so tests use it only if it is installed.
LEROBOT_READY := .venv-lerobot/ready

.PHONY: lerobot-env
lerobot-env: $(LEROBOT_READY)  ## an environment with LeRobot, in which tests open an export by its own factory

$(LEROBOT_READY): envs/lerobot.sh envs/lerobot.lock | $(SETUP)
	@envs/lerobot.sh $@

.PHONY: test
test: $(CHECKS) $(CCX_FOUND) $(COMPILED)  ## the tests of every change, in minutes: all but the slow ones
	@$(PYTEST) -m 'not slow' $(or $(value TESTS),tests)

.PHONY: test-all
test-all: $(CHECKS) $(CCX_FOUND) $(COMPILED)  ## all tests, in half an hour; MARKED=slow: those that `make test` leaves out
	@$(PYTEST) $(if $(value MARKED),-m '$(value MARKED)') $(or $(value TESTS),tests)

.PHONY: lint
lint: $(CHECKS)  ## check style, names, types and imports of the code, and that generated files are up to date
	@$(PY) -m ruff check
	@$(PY) -m ruff format --check
	@$(PY) -m mypy
	@$(PY_HERE) -m tests.lint.checks

.PHONY: format
format: $(CHECKS)  ## format the code, and write what is generated: tables of figures, parameters.md, digests of stages
	@$(PY) -m ruff check --fix
	@$(PY) -m ruff format
	@$(PY_HERE) -m tests.lint.checks --fix

.PHONY: lock
lock: $(CHECKS)  ## write the lock files from the installed packages; a new package goes to envs/requirements.lock
	@$(PY) -m pip freeze --exclude-editable | sed 's/+cpu$$//' | awk -F== '{if (FILENAME != "-") of[$$1] = FILENAME; \
	    else print > (($$1 in of ? of[$$1] : "envs/requirements.lock") ".part")}' envs/checks.lock envs/formats.lock -
	@for name in checks formats requirements; do mv envs/$$name.lock.part envs/$$name.lock; done

BENCHMARKS := $(patsubst tests/benchmarks/%.py,benchmark-%,$(filter-out %/__init__.py %/__main__.py,$(wildcard tests/benchmarks/*.py)))
.PHONY: $(BENCHMARKS)
$(BENCHMARKS): benchmark-%: $(CHECKS) $(CCX_FOUND)
	@$(PY_HERE) -m tests.benchmarks $* --out results/benchmarks/$*.json

.PHONY: benchmark-tables
benchmark-tables: $(CHECKS)  ## write figures of results/benchmarks/ into README and the network's card, name what changed
	@$(PY_HERE) -m tests.lint.tables

.PHONY: real-check
real-check: $(CHECKS)  ## run benchmark-real; real images with their predictions: results/real-check/index.html
	@$(PY_HERE) -m tests.benchmarks.real $(AT_REFERENCE) --page results/real-check/index.html

.PHONY: benchmark-X
benchmark-X:  ## measure a group of figures; make benchmark-X lists the names that X may take
	@echo "$(BENCHMARKS)"
