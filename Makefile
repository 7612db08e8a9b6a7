# The two commands: `make run` and `make test`. Each installs what it needs; a second call reuses it.
PYTHON ?= python3
VENV ?= .venv
BIN := $(VENV)/bin
PIP = $(BIN)/python -m pip --quiet --disable-pip-version-check

# What is installed. Each marker needs the one before it, so no two installations run at once, even
# with --jobs. A marker is written last, so that an interrupted installation is done again.
PRODUCT := $(VENV)/.product
TESTS := $(VENV)/.tests
CHECKS := $(VENV)/.checks
UV := $(VENV)/.uv
MUTANTS := $(VENV)/.mutants

.PHONY: run test wheel test-oldest test-pythons mutants lint docs count clean help

help:
	@echo "make run    the paper's table, figures and replays: open results/index.html"
	@echo "make test   run the test suite"
	@echo "make wheel  the wheel in a fresh environment: every command, on finger, ur5 and an own arm"
	@echo "make test-oldest   the tests with the oldest packages that pyproject.toml admits"
	@echo "make test-pythons  the tests with each supported Python that is found"
	@echo "make mutants  a seeded sample of planted faults, each against its tests; goes on where it was"
	@echo "make lint   ruff, mypy, that imports point one way, the plan of the house and its tests"
	@echo "make docs   the documentation as a site: open build/docs/index.html"
	@echo "make count  what the wheel and the proof hold: lines, kernels, constants, commands, names"
	@echo "make clean  remove the virtual environment and build leftovers"

run: $(PRODUCT)
	$(BIN)/python scripts/benchmark.py

test: $(TESTS)
	$(BIN)/python -m pytest -n auto

WHEEL ?= --all
wheel:
	$(PYTHON) .ci/wheel.py $(WHEEL)

# uv chooses the packages and finds the interpreters; CI runs these two apart (.ci/optional).
test-oldest: $(UV)
	$(BIN)/uv venv --quiet --clear --python 3.11 .venv-oldest
	$(BIN)/uv pip install --quiet --python .venv-oldest --resolution lowest-direct --editable ".[test,bench,cluster]"
	.venv-oldest/bin/python -m pytest -n auto

test-pythons: $(UV)
	@set -e; export PYENV_VERSION=$$(pyenv versions --bare 2>/dev/null | paste -sd:); \
	for version in 3.11 3.12 3.13; do \
	  if ! found=$$($(BIN)/uv python find --no-python-downloads $$version 2>/dev/null); then \
	    echo "Python $$version: not found, UNTESTED"; continue; fi; \
	  echo "Python $$version: $$found"; \
	  $(BIN)/uv venv --quiet --clear --python $$found .venv-$$version; \
	  $(BIN)/uv pip install --quiet --python .venv-$$version --editable ".[test]"; \
	  .venv-$$version/bin/python -m pytest -n auto; \
	done

mutants: $(MUTANTS)
	nice $(BIN)/python .ci/mutants.py
	$(BIN)/python .ci/mutants.py --report

lint: $(CHECKS)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports
	$(BIN)/python .ci/house.py
	$(BIN)/python -m pytest .ci

docs: $(CHECKS)
	$(BIN)/python -m tests.proof gallery
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict --config-file docs/site/mkdocs.yml

$(PRODUCT): pyproject.toml
	$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "softdyn needs Python 3.11 or newer: make PYTHON=python3.12 ...")'
	test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	$(PIP) install --editable .
	touch $@

$(TESTS): $(PRODUCT)
	$(PIP) install --editable ".[test,bench,cluster,sysid]"
	touch $@

$(CHECKS): $(TESTS)
	$(PIP) install --editable ".[lint,docs]"
	touch $@

$(UV): $(CHECKS)
	$(PIP) install uv
	touch $@

$(MUTANTS): $(UV)
	$(PIP) install --editable ".[mutants]"
	touch $@

count:
	@$(PYTHON) .ci/code_lines.py

clean:
	rm -rf $(VENV) .venv-* build dist *.egg-info .pytest_cache .mypy_cache .ruff_cache
