# The whole interface: make demo, make test, make test-fast, make test-all, make matrix, make check, make bench, make chaos,
# make docs, make release.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
READY := $(VENV)/.ready
# Setuptools warns of each editable installation.
PIP_INSTALL := -m pip install --quiet --disable-pip-version-check
INSTALL := PYTHONWARNINGS=ignore $(BIN)/python $(PIP_INSTALL) -c constraints.txt
# The pip of an older Python takes a minute more to choose the versions.
environment = $(PYTHON) -m venv $(1) && $(1)/bin/python $(PIP_INSTALL) -c constraints.txt pip
WORKERS ?= 2
SECONDS ?= 120

.PHONY: demo test test-all test-fast test-lowest test-ray matrix check bench chaos docs release clean

$(VENV):
	$(PYTHON) -c 'import sys; sys.exit(None if sys.version_info >= (3, 11) else "Zenostat needs Python 3.11 or newer")'
	$(call environment,$(VENV))

# What the README shows, and what the tests need besides (torch among it), in one environment, in either order.
$(READY): pyproject.toml constraints.txt | $(VENV)
	$(INSTALL) -e '.[grid,plots,recording]'
	touch $@

# Of torch and what comes with it, 13,000 files, the tests import a part: these are compiled when they are imported.
$(READY)-dev: pyproject.toml constraints.txt | $(VENV)
	$(INSTALL) --no-compile -e '.[dev,plots]'
	touch $(READY) $@

demo: $(READY)  ## A building, its controller and its monitor in separate processes; results in demo/
	$(BIN)/zenostat demo --folder demo

PYTEST := $(BIN)/python -m pytest -n $(WORKERS) --dist worksteal

test: $(READY)-dev  ## What each change must pass: all tests but the long ones
	$(PYTEST) -m "not slow"

test-all: $(READY)-dev test-lowest test-ray  ## All tests: years of fidelity, every scenario, 120 s of chaos, a thousand branches
	$(PYTEST)

test-fast: $(READY)-dev  ## The rules alone: no simulation, no other process
	$(PYTEST) -m "not slow and not process"

LOWEST := .venv-lowest
LOWEST_TESTS := tests/agent_sdk/test_lowest_versions.py tests/agent_sdk/test_actions.py \
	tests/agent_sdk/test_wrappers__named_values.py tests/system/test_environment__other_libraries.py

$(LOWEST)/.ready: pyproject.toml constraints-lowest.txt
	$(call environment,$(LOWEST))
	PYTHONWARNINGS=ignore $(LOWEST)/bin/python $(PIP_INSTALL) -c constraints-lowest.txt \
		-e . pytest pytest-timeout hypothesis
	touch $@

test-lowest: $(LOWEST)/.ready  ## A core of the tests with the lowest versions of all direct dependencies
	$(LOWEST)/bin/python -m pytest -q -W "ignore:'click.utils:DeprecationWarning" $(LOWEST_TESTS)

RAY := .venv-ray
RAY_TESTS := tests/agent_sdk/test_ray.py tests/system/test_environment__other_libraries.py

# Ray pins an older Gymnasium than the one that is tested otherwise.
$(RAY)/.ready: pyproject.toml constraints-ray.txt
	$(call environment,$(RAY))
	PYTHONWARNINGS=ignore $(RAY)/bin/python $(PIP_INSTALL) -c constraints-ray.txt \
		-e '.[ray,multi-agent]' torchrl pytest pytest-timeout hypothesis
	touch $@

test-ray: $(RAY)/.ready  ## RLlib, Tune, a cluster of two raylets, and TorchRL's checks, in an environment of their own
	$(RAY)/bin/python -m pytest -q $(RAY_TESTS)

MATRIX := 3.11 3.12 3.13

# An interpreter is looked for on the path, and among those of pyenv.
matrix: $(MATRIX:%=matrix-%)  ## The rules with each version of Python that is on the machine, in environments without torch

matrix-%:
	@for python in python$* $$(ls -d $${PYENV_ROOT:-$$HOME/.pyenv}/versions/$*.*/bin/python 2> /dev/null); do \
		if $$python -c "" 2> /dev/null; then \
			$(MAKE) .venv-$*/.ready PYTHON=$$python && \
			.venv-$*/bin/python -m pytest -n $(WORKERS) --dist worksteal -m "not slow and not process"; exit; \
		fi; \
	done; echo "Python $* is not on this machine: skipped."

.venv-3.%/.ready: pyproject.toml constraints.txt
	$(call environment,.venv-3.$*)
	PYTHONWARNINGS=ignore .venv-3.$*/bin/python $(PIP_INSTALL) -c constraints.txt -e '.[test]'
	touch $@

check: $(READY)-dev  ## Format, lint, types
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/python .ci/check_source.py & \
	$(BIN)/mypy --num-workers $(WORKERS); types=$$?; wait $$! && exit $$types

bench: $(READY)-dev  ## What a step costs, as ratios within one run; results in bench/results/
	$(BIN)/python -m bench

chaos: $(READY)-dev  ## A building troubled at random for SECONDS, then recorded nodes killed as long; SEED=… has the same again, TABLE=… puts the table into a page
	PYTHONPATH=.:tests $(BIN)/python -P -m chaos --seconds $(SECONDS) $(if $(SEED),--seed $(SEED)) $(if $(TABLE),--table $(TABLE))
	PYTHONPATH=.:tests $(BIN)/python -P -m chaos.recordings --seconds $(SECONDS) $(if $(SEED),--seed $(SEED))

docs: $(READY)-dev  ## The documentation as a web site, in site/; any warning is an error
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict

release: $(READY)  ## The files to publish, in dist/, built twice and checked; prints how to upload them
	$(INSTALL) -e '.[release]'
	.ci/release

clean:  ## Removes what the others made
	rm -rf $(VENV) $(LOWEST) $(RAY) $(MATRIX:%=.venv-%) demo dist bench/results site .mypy_cache .ruff_cache .pytest_cache .hypothesis *.egg-info
