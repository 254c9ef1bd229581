# make demo    set everything up and run the main job        make test    set everything up and run the tests
# make test-all    and those that take minutes
# make lint types layers    the other checks                 make clean   remove what these made
# PYTHON=python3.12 make demo    another interpreter

PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
READY := $(VENV)/.ready

.PHONY: demo test test-all lint types layers bench clean

demo: $(READY)
	$(BIN)/robustlab run first-light --out out/first-light

PYTEST := $(BIN)/python -m pytest -q -n auto --maxprocesses 4 --dist loadfile --no-loadscope-reorder

test: $(READY)
	$(PYTEST) -m "not slow"

test-all: $(READY)
	$(PYTEST)

lint: $(READY)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

types: $(READY)
	$(BIN)/pyright --threads 2 --pythonpath $(BIN)/python

layers: $(READY)
	$(BIN)/lint-imports

bench: $(READY)
	$(BIN)/python benchmarks/startup.py

# The stamp is made last, so that an interrupted set-up starts again.
$(READY): pyproject.toml
	$(PYTHON) -c 'import sys; sys.exit("robustlab needs Python 3.11 or newer, this is " + sys.version) if sys.version_info < (3, 11) else 0'
	test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable '.[dev]'
	touch $@

clean:
	rm -rf $(VENV) out build dist .pytest_cache .ruff_cache .hypothesis .benchmarks .import_linter_cache
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
