# make demo    set everything up and run the main job        make test    set everything up and run the tests
# make test-all    and those that take minutes
# make lint types layers    the other checks                 make clean   remove what these made
# make docs    build the site into out/docs; every warning is an error, every tutorial is executed
# make check-docs    look at the built site in a browser, if there is one; check-report: at the report of first-light
# PYTHON=python3.12 make demo    another interpreter

PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
# Stamps, made last, so that an interrupted set-up starts again: what the demo needs, with the tests' tools, with the site's.
READY := $(VENV)/.ready
DEV_READY := $(VENV)/.ready-dev
DOCS_READY := $(VENV)/.ready-docs
# For the demo modules are compiled when they are used: compiling all that is installed costs 10 s of CPU. The tests start
# Python often, and where PYTHONDONTWRITEBYTECODE is set nothing is kept: there all is compiled (files of other versions
# of Python cannot be, which is no error).
INSTALL := $(BIN)/python -m pip install --quiet --disable-pip-version-check --no-compile --editable
COMPILE := $(BIN)/python -m compileall -q -q $(VENV)/lib || true

.PHONY: demo test test-all lint types layers bench docs check-docs check-report clean

demo: $(READY)
	$(BIN)/robustlab run first-light --out out/first-light

PYTEST := $(BIN)/python -m pytest -q -n auto --maxprocesses 4 --dist loadfile --no-loadscope-reorder

test: $(DEV_READY)
	$(PYTEST) -m "not slow"

test-all: $(DEV_READY)
	$(PYTEST)

lint: $(DEV_READY)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/python tools/language.py

types: $(DEV_READY)
	$(BIN)/pyright --threads 2 --pythonpath $(BIN)/python

layers: $(DEV_READY)
	$(BIN)/lint-imports

bench: $(DEV_READY)
	$(BIN)/python benchmarks/startup.py

docs: $(DOCS_READY)
	OPENBLAS_NUM_THREADS=1 $(BIN)/python -m sphinx --jobs 2 --fail-on-warning --keep-going --quiet --fresh-env docs out/docs

check-docs: docs
	$(BIN)/python docs/check_site.py out/docs

check-report: $(DOCS_READY)
	$(BIN)/robustlab run first-light --out out/first-light
	$(BIN)/python docs/check_report.py out/first-light/report.html

$(DOCS_READY): $(DEV_READY)
	$(INSTALL) '.[docs]'
	$(COMPILE)
	touch $@

$(DEV_READY): $(READY)
	$(INSTALL) '.[dev]'
	$(COMPILE)
	touch $@

$(READY): pyproject.toml
	$(PYTHON) -c 'import sys; sys.exit("robustlab needs Python 3.11 or newer, this is " + sys.version) if sys.version_info < (3, 11) else 0'
	test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	$(INSTALL) .
	touch $@

clean:
	rm -rf $(VENV) out build dist .pytest_cache .ruff_cache .hypothesis .benchmarks .import_linter_cache
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
