# Every target sets up $(VENV) itself, from requirements.lock, with hashes. Needed first on a fresh Debian:
#     sudo apt install make python3-venv

PYTHON ?= python3
VENV ?= .venv
ARGS ?=

# One stamp a Python version: `make test PYTHON=python3.13` after `make test` builds the environment anew.
VERSION := $(shell $(PYTHON) -c 'import sys; print("%d.%d" % sys.version_info[:2])' 2>/dev/null)
READY := $(VENV)/ready-$(VERSION)
export PIP_DISABLE_PIP_VERSION_CHECK = 1
export PIP_ROOT_USER_ACTION = ignore

.PHONY: help demo test weeks study check bench lock clean
.DELETE_ON_ERROR:

help: ## what can be made
	@awk -F ':.*## ' '/^[a-z]+:.*## / { printf "  make %-6s %s\n", $$1, $$2 }' Makefile
	@echo 'ARGS="..." is passed on; PYTHON=python3.13 chooses another Python.'

demo: $(READY) ## a week of charging, simulated, in about a minute
	$(VENV)/bin/plugd demo $(ARGS)

test: $(READY) ## every test this machine can run, and a list of what it could not
	$(VENV)/bin/python -m pytest $(ARGS)

weeks: $(READY) ## the README's four weeks on measured intensity ($PLUGD_DATA), and that they hold
	$(VENV)/bin/python tests/four_weeks.py

study: $(READY) ## the paper's table and regions on measured intensity ($PLUGD_DATA), two seeds, and that they hold
	$(VENV)/bin/python tests/study_figures.py

check: $(READY) ## style, types, layers
	$(VENV)/bin/ruff check
	$(VENV)/bin/ruff format --check
	$(VENV)/bin/mypy
	$(VENV)/bin/lint-imports

bench: $(READY) ## every bench/*.py, one after the other
	@set -e; found=0; for bench in bench/*.py; do \
	  if [ -e "$$bench" ]; then found=1; echo "== $$bench"; $(VENV)/bin/python "$$bench" $(ARGS); fi; \
	done; if [ $$found = 0 ]; then echo 'make bench: there is no bench/*.py yet'; fi

lock: python ## requirements.lock anew from pyproject.toml (ARGS=--upgrade for newer versions)
	$(PYTHON) -m venv --clear $(VENV)-lock
	$(VENV)-lock/bin/python -m pip install --quiet uv
	$(VENV)-lock/bin/uv pip compile --quiet --universal --python-version 3.11 --all-extras --generate-hashes \
	  --only-binary :all: --no-header --no-annotate --no-emit-index-url --output-file requirements.lock $(ARGS) pyproject.toml
	rm -rf $(VENV)-lock

clean: ## remove the environment and every cache
	rm -rf $(VENV) $(VENV)-lock build dist *.egg-info hil/*.egg-info
	rm -rf .pytest_cache .mypy_cache .ruff_cache .import_linter_cache .hypothesis
	find . -name __pycache__ -type d -prune -exec rm -rf {} +

.PHONY: python
python:
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null \
	  || { echo "plugd needs Python 3.11 or newer, and '$(PYTHON)' is not: sudo apt install make python3-venv," \
	            "or name another with PYTHON=python3.13" >&2; exit 1; }
	@$(PYTHON) -c 'import ensurepip, venv' 2>/dev/null \
	  || { echo "'$(PYTHON)' cannot make a virtual environment: sudo apt install make python3-venv" >&2; exit 1; }

$(READY): requirements.lock pyproject.toml | python
	$(PYTHON) -m venv --clear $(VENV)
	$(VENV)/bin/python -m pip install --quiet --require-hashes --only-binary :all: --requirement requirements.lock
	$(VENV)/bin/python -m pip install --quiet --no-deps --no-build-isolation --no-index --editable .
	@touch $@
