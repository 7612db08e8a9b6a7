# The two commands: `make run` and `make test`. Both set up what they need; a second call reuses it.
PYTHON ?= python3
VENV ?= .venv
BIN := $(VENV)/bin
READY := $(VENV)/.ready

.PHONY: run test wheel test-oldest test-pythons mutants lint docs count clean help

help:
	@echo "make run    the paper's table, figures and replays: open results/index.html"
	@echo "make test   run the test suite"
	@echo "make wheel  the wheel in a fresh environment: every command, on finger, ur5 and an own arm"
	@echo "make test-oldest   the tests with the oldest packages that pyproject.toml admits"
	@echo "make test-pythons  the tests with each supported Python that is found"
	@echo "make mutants  a seeded sample of planted faults, each against its tests; goes on where it was"
	@echo "make lint   ruff, mypy, that imports point one way, and the plan of the house"
	@echo "make docs   the documentation as a site: open build/docs/index.html"
	@echo "make count  what the wheel and the proof hold: lines, kernels, constants, commands, names"
	@echo "make clean  remove the virtual environment and build leftovers"

run: $(READY)
	$(BIN)/python scripts/benchmark.py

test: $(READY)
	$(BIN)/python -m pytest -n auto

WHEEL ?= --all
wheel:
	$(PYTHON) .ci/wheel.py $(WHEEL)

# uv chooses the packages and finds the interpreters; CI runs these two apart (.ci/optional).
UV = $(BIN)/uv
$(UV): $(READY)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check uv

test-oldest: $(UV)
	$(UV) venv --quiet --clear --python 3.11 .venv-oldest
	$(UV) pip install --quiet --python .venv-oldest --resolution lowest-direct --editable ".[test,bench,cluster]"
	.venv-oldest/bin/python -m pytest -n auto

test-pythons: $(UV)
	@set -e; export PYENV_VERSION=$$(pyenv versions --bare 2>/dev/null | paste -sd:); \
	for version in 3.11 3.12 3.13; do \
	  if ! found=$$($(UV) python find --no-python-downloads $$version 2>/dev/null); then \
	    echo "Python $$version: not found, UNTESTED"; continue; fi; \
	  echo "Python $$version: $$found"; \
	  $(UV) venv --quiet --clear --python $$found .venv-$$version; \
	  $(UV) pip install --quiet --python .venv-$$version --editable ".[test]"; \
	  .venv-$$version/bin/python -m pytest -n auto; \
	done

mutants: $(READY)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable ".[dev,mutants]"
	nice $(BIN)/python .ci/mutants.py
	$(BIN)/python .ci/mutants.py --report

lint: $(READY)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports
	$(BIN)/python .ci/house.py

docs: $(READY)
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict --config-file docs/site/mkdocs.yml

# The marker is written last, so an interrupted set-up is done again.
$(READY): pyproject.toml
	$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "softdyn needs Python 3.11 or newer: make PYTHON=python3.12 ...")'
	test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable ".[dev]"
	touch $(READY)

count:
	@$(PYTHON) .ci/code_lines.py

clean:
	rm -rf $(VENV) .venv-* build dist *.egg-info .pytest_cache .mypy_cache .ruff_cache
