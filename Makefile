# The whole interface: make demo, make test, make check, make bench, make chaos, make docs.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
READY := $(VENV)/.ready
WORKERS ?= 2
SECONDS ?= 120

.PHONY: demo test check bench chaos docs clean

$(READY): pyproject.toml constraints.txt
	$(PYTHON) -c 'import sys; sys.exit(None if sys.version_info >= (3, 11) else "Zenostat needs Python 3.11 or newer")'
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e '.[dev]'
	touch $(READY)

demo: $(READY)  ## A building, its controller and its monitor in separate processes; results in demo/
	$(BIN)/zenostat demo --folder demo

test: $(READY)  ## All tests
	$(BIN)/python -m pytest -n $(WORKERS)

check: $(READY)  ## Format, lint, types
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy

bench: $(READY)  ## What a step costs, as ratios within one run; results in bench/results/
	$(BIN)/python -m bench

chaos: $(READY)  ## A building troubled at random for SECONDS; SEED=… has the same again, TABLE=… puts the table into a page
	PYTHONPATH=tests $(BIN)/python -P -m chaos --seconds $(SECONDS) $(if $(SEED),--seed $(SEED)) $(if $(TABLE),--table $(TABLE))

docs: $(READY)  ## The documentation as a web site, in site/; any warning is an error
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict

clean:  ## Removes what the others made
	rm -rf $(VENV) demo bench/results site .mypy_cache .ruff_cache .pytest_cache .hypothesis *.egg-info
