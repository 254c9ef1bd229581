# make demo    set everything up and run the main job        make test    set everything up and run the tests
# make test-all    and those that take minutes
# make lint types layers    the other checks                 make clean   remove what these made
# make docs    build the site into out/docs; every warning is an error, every tutorial is executed
# make check-docs    look at the built site in a browser, if there is one; check-report: at the report of first-light
# PYTHON=python3.12 make demo    another interpreter

PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
READY := $(VENV)/.ready

DOCS_READY := $(VENV)/.ready-docs

.PHONY: demo test test-all lint types layers bench docs check-docs check-report clean

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

docs: $(DOCS_READY)
	OPENBLAS_NUM_THREADS=1 $(BIN)/python -m sphinx --jobs 2 --fail-on-warning --keep-going --quiet --fresh-env docs out/docs

check-docs: docs
	$(BIN)/python docs/check_site.py out/docs

check-report: $(DOCS_READY)
	$(BIN)/robustlab run first-light --out out/first-light
	$(BIN)/python docs/check_report.py out/first-light/report.html

# The stamps are made last, so that an interrupted set-up starts again.
$(DOCS_READY): $(READY)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable '.[docs]'
	touch $@

$(READY): pyproject.toml
	$(PYTHON) -c 'import sys; sys.exit("robustlab needs Python 3.11 or newer, this is " + sys.version) if sys.version_info < (3, 11) else 0'
	test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable '.[dev]'
	touch $@

clean:
	rm -rf $(VENV) out build dist .pytest_cache .ruff_cache .hypothesis .benchmarks .import_linter_cache
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
