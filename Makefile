# The two commands: `make run` and `make test`. Both set up what they need; a second call reuses it.
PYTHON ?= python3
VENV ?= .venv
BIN := $(VENV)/bin
READY := $(VENV)/.ready

.PHONY: run test lint count clean help

help:
	@echo "make run    the paper's table, figures and replays: open results/index.html"
	@echo "make test   run the test suite"
	@echo "make lint   ruff, mypy, and that imports point one way"
	@echo "make count  lines of code, folder by folder"
	@echo "make clean  remove the virtual environment and build leftovers"

run: $(READY)
	$(BIN)/python scripts/benchmark.py

test: $(READY)
	$(BIN)/python -m pytest -n auto

lint: $(READY)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

# The marker is written last, so an interrupted set-up is done again.
$(READY): pyproject.toml
	$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "softdyn needs Python 3.11 or newer: make PYTHON=python3.12 ...")'
	test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable ".[dev]"
	touch $(READY)

count:
	@$(PYTHON) .ci/code_lines.py

clean:
	rm -rf $(VENV) build dist *.egg-info .pytest_cache .mypy_cache .ruff_cache
