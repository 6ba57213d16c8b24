# Set-up is done once, and again only when pyproject.toml changes. Nothing but Python and pip is needed.
.DEFAULT_GOAL := help
.PHONY: help bench test test-slow test-all test-oldest lint same format docs lock clean

PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
PIP := $(BIN)/python -m pip install --quiet --disable-pip-version-check
BENCH ?= --preset quick
PYTEST ?=
# Tests start hundreds of processes: without bytecode each compiles all modules, and reads all code to know what it is.
RUN_TESTS = env -u PYTHONDONTWRITEBYTECODE $(BIN)/python -m pytest --numprocesses $(WORKERS) --dist loadfile --max-worker-restart 0 --durations 20
WORKERS ?= 2
EXTRAS := dev,gtsam,evo,bags,gl,dask,rl,video,docs,viewer,pictures,notebooks
PYTHONS ?= python3.11 python3.12 python3.13

# The matrices are small: a second BLAS thread never helps and can cost a lot. Parallelism comes from whole runs.
export OPENBLAS_NUM_THREADS := 1
export OMP_NUM_THREADS := 1
export MKL_NUM_THREADS := 1

help: ## Show this help
	@grep -hE '^[a-z-]+:.*## ' $(MAKEFILE_LIST) | awk -F ':.*## ' '{printf "  make %-9s %s\n", $$1, $$2}'
	@echo "  variables: PYTHON=$(PYTHON)  BENCH=\"$(BENCH)\" (arguments of stereo-slam bench)  PYTEST=\"...\" (of pytest)  WORKERS=$(WORKERS) (processes of pytest)"

bench: $(VENV)/.installed ## Compare the filters in the simulated world and write the report (under a minute after set-up)
	@$(BIN)/stereo-slam bench $(BENCH)

test: lint ## Lint, types and the test suite (20 minutes after set-up)
	@$(BIN)/stereo-slam warm-up
	@$(RUN_TESTS) -m 'not slow' $(PYTEST)

test-slow: $(VENV)/.installed-dev ## Examples, the manual, packaging, browser, clusters, long statistics
	@$(RUN_TESTS) -m slow $(PYTEST)

test-all: test test-slow ## All of them

test-oldest: ## The tests of the filters with the oldest versions of all that is declared (Python 3.11 or 3.12)
	@$(PYTHON) -m venv $(VENV)-oldest
	@$(PYTHON) .ci/oldest.py > $(VENV)-oldest/requirements.txt
	@$(VENV)-oldest/bin/python -m pip install --quiet --disable-pip-version-check \
	  --requirement $(VENV)-oldest/requirements.txt pytest pytest-timeout hypothesis
	@PYTHONPATH=. $(VENV)-oldest/bin/python -m pytest --quiet -m 'not slow' tests/filters/engine/test_golden.py \
	  tests/filters/landmarks tests/filters/measurements tests/filters/motions tests/filters/errors $(PYTEST)
	@PYTHONPATH=. $(VENV)-oldest/bin/python -m stereo_slam_env --help >/dev/null
	@PYTHONPATH=. $(VENV)-oldest/bin/python -m stereo_slam_env bench --preset turn --seeds 2 --frames 20 --out $(VENV)-oldest/bench

lint: $(VENV)/.installed-dev ## ruff, the order of the rooms (import-linter), mypy
	@$(BIN)/ruff check
	@$(BIN)/ruff format --check
	@$(BIN)/lint-imports --no-cache --no-logo >/dev/null || $(BIN)/lint-imports --no-cache --no-logo
	@$(BIN)/mypy

same: $(VENV)/.installed-dev ## Figures that must not change while the code is rearranged (three minutes)
	@$(BIN)/python benchmarks/same.py

format: $(VENV)/.installed-dev ## Let ruff put the code in order
	@$(BIN)/ruff check --fix
	@$(BIN)/ruff format

docs: $(VENV)/.installed-docs ## Build the manual into site/ (open site/index.html; nothing is fetched)
	@NO_MKDOCS_2_WARNING=1 $(BIN)/python -m mkdocs build --strict
	@echo "the manual: site/index.html"

lock: ## Pin what the tests run with anew, for each of PYTHONS, in constraints.txt (nothing is installed)
	@$(PYTHON) .ci/lock.py $(PYTHONS)

clean: ## Remove the virtual environment, builds and caches (results in runs/ stay)
	rm -rf $(VENV) $(VENV)-oldest build dist site *.egg-info .mypy_cache .ruff_cache .pytest_cache .hypothesis .benchmarks
	find filters stereo_slam_env tests examples benchmarks -name __pycache__ -type d -prune -exec rm -rf {} +

$(BIN)/python:
	@$(PYTHON) -c 'import sys; v = sys.version_info[:2]; sys.exit(not (3, 11) <= v < (3, 15) and "Python %d.%d found, but 3.11 to 3.14 are supported: make PYTHON=python3.13" % v)'
	@echo "setting up $(VENV) with $(PYTHON) ..."
	@$(PYTHON) -m venv $(VENV)

$(VENV)/.installed: pyproject.toml | $(BIN)/python
	@$(PIP) --editable .
	@touch $@

$(VENV)/.installed-dev: pyproject.toml constraints.txt constraints-pybullet.txt | $(BIN)/python
	@$(PIP) --require-hashes --no-deps --requirement constraints-pybullet.txt
	@$(PIP) --constraint constraints.txt --editable '.[$(EXTRAS)]'
	@touch $@ $(VENV)/.installed $(VENV)/.installed-docs

$(VENV)/.installed-docs: pyproject.toml constraints.txt | $(BIN)/python
	@$(PIP) --constraint constraints.txt --editable '.[docs]'
	@touch $@
