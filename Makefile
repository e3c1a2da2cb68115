# Every target sets up $(VENV) itself, from requirements.lock, with hashes; `bench` one of its own, with what it compares.
# Needed first on a fresh Debian:
#     sudo apt install make python3-venv

PYTHON ?= python3
VENV ?= .venv
ARGS ?=
STORE ?=
PLUGD_DATA ?= $(abspath ../shared/data)
CAN_WEEK ?=
PLUGS ?=
# Real hubs for `make hub-test`. Home Assistant wants Python 3.13 or newer; without Node-RED its part is left out.
HASS ?= .venv-hass/bin/hass
HASS_PYTHON ?= python3.13
NODE_RED ?= $(shell command -v node-red)

# One stamp a Python version: `make test PYTHON=python3.13` after `make test` builds the environment anew.
VERSION := $(shell $(PYTHON) -c 'import sys; print("%d.%d" % sys.version_info[:2])' 2>/dev/null)
READY := $(VENV)/ready-$(VERSION)
BENCH ?= $(filter-out bench/footprint.py,$(wildcard bench/*.py))
BENCH_READY := $(VENV)-bench/ready-$(VERSION)
LOCK := $(VENV)-lock/bin/uv pip compile --quiet --universal --python-version 3.11 --generate-hashes \
  --only-binary :all: --no-header --no-annotate --no-emit-index-url
export PIP_DISABLE_PIP_VERSION_CHECK = 1
export PIP_ROOT_USER_ACTION = ignore

.PHONY: help demo test hub-test pictures weeks study plugs deadman fuzz broken can-week can-fuzz fuzz-parsers nights nights-mqtt chaos scenarios natural check bench lock clean deb test-deb test-arm64
.PHONY: footprint sbom audit
.DELETE_ON_ERROR:

help: ## what can be made
	@awk -F ':.*## ' '/^[a-z0-9-]+:.*## / { printf "  make %-10s %s\n", $$1, $$2 }' Makefile
	@echo 'ARGS="..." is passed on; PYTHON=python3.13 chooses another Python.'

demo: $(READY) ## a week of charging, simulated, in about a minute
	$(VENV)/bin/plugd demo $(ARGS)

test: $(READY) ## every test this machine can run, on every core, and a list of what it could not
	$(VENV)/bin/python -m pytest --numprocesses auto --dist loadfile --no-loadscope-reorder $(ARGS)

hub-test: $(READY) $(HASS) ## against a real Home Assistant, and Node-RED where it is installed; on loopback only
	$(VENV)/bin/python -m tests.hub.home_assistant --hass "$(HASS)" $(ARGS)
	if [ -n "$(NODE_RED)" ]; then $(VENV)/bin/python -m tests.hub.node_red --node-red "$(NODE_RED)"; fi

.venv-hass/bin/hass:
	$(HASS_PYTHON) -m venv --clear .venv-hass
	.venv-hass/bin/python -m pip install --quiet homeassistant

pictures: $(READY) ## the pictures of the page in docs/, anew, from ten simulated days
	$(VENV)/bin/python -m tests.web.pictures $(ARGS)

weeks: $(READY) measured ## the README's four weeks on measured intensity ($PLUGD_DATA), and that they hold
	$(VENV)/bin/python tests/four_weeks.py

plugs: $(READY) ## every plug: the whole contract suite, and a simulated week of each
	$(VENV)/bin/python -m pytest --every-plug $(PLUGS) tests/contract tests/hil/test_every_plug.py $(ARGS)

deadman: $(READY) ## plugd killed at each quarter hour of many nights: the plug charges the car alone
	$(VENV)/bin/python -m tests.dead_man $(ARGS)

fuzz: $(READY) ## a million payloads at everything that a plug may say
	$(VENV)/bin/python -m tests.fuzz_plugs --payloads 1000000 $(ARGS)

broken: $(READY) measured ## weeks with a broken API on measured intensity ($PLUGD_DATA): no morning missed, little more carbon
	PLUGD_DATA="$(PLUGD_DATA)" $(VENV)/bin/python -m tests.broken_api $(ARGS)

can-week: $(READY) ## a week of the demo with the charger on CAN: no morning missed
	$(VENV)/bin/python tests/can_week.py $(CAN_WEEK)

can-fuzz: $(READY) ## a million frames at random against the charger on CAN
	$(VENV)/bin/python -m tests.fuzz_can $(ARGS)

fuzz-parsers: $(READY) ## forecasts, commands, configuration, problem files, requests, stored state: damaged, a million
	$(VENV)/bin/python -m tests.fuzz_parsers --inputs 1000000 $(ARGS)

nights: $(READY) ## two thousand nights in which things fail, five hundred with two at once: no morning missed
	$(VENV)/bin/python -m tests.chaos $(ARGS)

chaos: $(READY) ## one table of docs/reliability.md: fuzz, a month, store, broker, nights; ARGS goes to the nights, STORE to the store
	STORE="$(STORE)" $(VENV)/bin/python -m tests.chaos_table $(ARGS)

nights-mqtt: $(READY) ## a hundred nights with real programs over real MQTT, things failing in most (a quarter of an hour)
	$(VENV)/bin/python -m tests.nights_mqtt $(ARGS)

study: $(READY) measured ## the paper's table and regions on measured intensity ($PLUGD_DATA), two seeds, and that they hold
	$(VENV)/bin/python tests/study_figures.py

check: $(READY) ## style, types, layers, security, the systemd unit
	$(VENV)/bin/ruff check
	$(VENV)/bin/ruff format --check
	$(VENV)/bin/mypy
	$(VENV)/bin/lint-imports
	$(VENV)/bin/python deploy/check_unit.py
	$(VENV)/bin/bandit --quiet --recursive --configfile pyproject.toml plugd hil/plugd_hil

scenarios: $(READY) ## everything that may go wrong with plug, charger and broker, one scenario after the other
	$(VENV)/bin/python -m plugd_hil bench hil/scenarios --jobs 2 $(ARGS)

natural: $(READY) ## those of them that last under a minute, on the real clock
	$(VENV)/bin/python -m plugd_hil bench hil/scenarios --natural --jobs 5 --out bench-out/natural $(ARGS)

deb: $(READY) ## the Debian package into dist/ (ARGS="--suite trixie --arch arm64": for others than this machine)
	$(VENV)/bin/python -m deploy.build_deb $(ARGS)

test-deb: $(READY) ## the package in a fresh Debian, booted (root; needs debootstrap and systemd-container; 3 minutes)
	$(VENV)/bin/python -m deploy.test_deb $(ARGS)

test-arm64: $(READY) ## package and tests in an emulated 64-bit ARM Debian (root; needs qemu-user-static too; an hour)
	$(VENV)/bin/python -m deploy.test_arm64 $(ARGS)

footprint: $(READY) ## what the daemon costs: memory after a month, processor, disk, start (ARGS=--quick: two days)
	$(VENV)/bin/python bench/footprint.py $(ARGS)

sbom: .venv-audit/bin/pip-audit ## sbom.json: everything in requirements.lock, with its hashes (CycloneDX)
	.venv-audit/bin/cyclonedx-py requirements --pyproject pyproject.toml --output-reproducible \
	  --output-format JSON --output-file sbom.json requirements.lock

audit: .venv-audit/bin/pip-audit ## known vulnerabilities of what the locks hold; asks the package index
	.venv-audit/bin/pip-audit --strict --disable-pip --require-hashes --requirement requirements.lock

.venv-audit/bin/pip-audit: | python
	$(PYTHON) -m venv --clear .venv-audit
	.venv-audit/bin/python -m pip install --quiet cyclonedx-bom pip-audit

bench: $(BENCH_READY) ## every program in bench/ (BENCH=bench/planner.py ARGS=--quick: one, shorter)
	@set -e; for bench in $(BENCH); do echo "== $$bench"; $(VENV)-bench/bin/python "$$bench" $(ARGS); done

lock: python ## both locks anew from pyproject.toml (ARGS=--upgrade for newer versions)
	$(PYTHON) -m venv --clear $(VENV)-lock
	$(VENV)-lock/bin/python -m pip install --quiet uv
	$(LOCK) $(addprefix --extra ,can web study dask demo hil dev) --output-file requirements.lock $(ARGS) pyproject.toml
	$(LOCK) --extra bench --constraint requirements.lock --output-file requirements-bench.lock $(ARGS) pyproject.toml
	rm -rf $(VENV)-lock

clean: ## remove the environment and every cache
	rm -rf $(VENV) $(VENV)-bench $(VENV)-lock .venv-hass .venv-audit sbom.json build dist *.egg-info hil/*.egg-info
	rm -rf .pytest_cache .mypy_cache .ruff_cache .import_linter_cache .hypothesis
	find . -name __pycache__ -type d -prune -exec rm -rf {} +

.PHONY: measured
measured:
	@test -f "$(PLUGD_DATA)/neso_national_2023.csv" \
	  || { echo "no measured intensity: set PLUGD_DATA to the folder with neso_national_2023.csv" >&2; exit 1; }

.PHONY: python
python:
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null \
	  || { echo "plugd needs Python 3.11 or newer, and '$(PYTHON)' is not: sudo apt install make python3-venv," \
	            "or name another with PYTHON=python3.13" >&2; exit 1; }
	@$(PYTHON) -c 'import ensurepip, venv' 2>/dev/null \
	  || { echo "'$(PYTHON)' cannot make a virtual environment: sudo apt install make python3-venv" >&2; exit 1; }

$(READY): requirements.lock
$(BENCH_READY): requirements-bench.lock
$(READY) $(BENCH_READY): pyproject.toml | python
	$(PYTHON) -m venv --clear $(@D)
	$(@D)/bin/python -m pip install --quiet --require-hashes --only-binary :all: --requirement $(filter %.lock,$^)
	$(@D)/bin/python -m pip install --quiet --no-deps --no-build-isolation --no-index --editable .
	@touch $@
