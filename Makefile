# Every target makes its own virtual environment first: nothing but Python >= 3.11 and make is needed.

PYTHON ?= python3
VENV   := .venv
BIN    := $(VENV)/bin
READY  := $(VENV)/.ready
DEMO   := demo

# Only variables that are set are passed on; the config decides the rest.
OPTIONS := $(if $(JOBS),--jobs $(JOBS)) $(if $(MOTORS),--motors "$(MOTORS)") $(if $(SINCE),--since $(SINCE)) $(if $(UNTIL),--until $(UNTIL))

.PHONY: help install fit-fleet look report check demo-logs lint format test test-full bench bench-guard validate docs \
        docs-site pictures wheelhouse clean

help:            ## list of targets
	@grep -E '^[a-z-]+:.*##' $(MAKEFILE_LIST) | sed -E 's/:[^#]*## */\t/' | expand -t 14

install: $(READY) ## the virtual environment with pinned packages

$(READY): requirements.txt pyproject.toml
	$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "Python 3.11 or newer is needed; say make PYTHON=...")'
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --require-hashes -r requirements.txt
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-deps --no-build-isolation -e .
	@touch $@

# The demo's logs are made where no fleet is named.
ifdef CONFIG
FLEET := $(CONFIG)
else
FLEET := configs/fleet.toml
fit-fleet report check look: demo-logs
report: fit-fleet
endif

fit-fleet: $(READY) ## fit a fleet: CONFIG=configs/fleet.toml JOBS=4 MOTORS="A B" SINCE=2026-01-01 UNTIL=...
	$(BIN)/motor-leakage fit-fleet $(FLEET) $(OPTIONS)

look: $(READY)   ## new minutes of growing logs, told at once: CONFIG=... EVERY=10min
	$(BIN)/motor-leakage look $(FLEET) $(if $(EVERY),--every $(EVERY)) $(if $(MOTORS),--motors "$(MOTORS)")

report: $(READY) ## pages of the fleet and its motors: CONFIG=configs/fleet.toml
	$(BIN)/motor-leakage report $(FLEET) $(if $(JOBS),--jobs $(JOBS))

check: $(READY)  ## check a fleet's config and the head of its logs: CONFIG=...
	$(BIN)/motor-leakage check $(FLEET)

demo-logs: $(DEMO)/truth.json ## simulated logs of the six motors of configs/fleet.toml, in demo/

$(DEMO)/truth.json: | $(READY)
	$(BIN)/motor-leakage demo .

lint: docs-site  ## style, types, law of imports, and up-to-date docs
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports
	$(BIN)/python -m pipeline.cli.reference --check docs

format: $(READY)
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

test: $(READY)   ## the tests of every change
	$(BIN)/pytest -n 2 -m "not full"

test-full: $(READY) ## all tests, with the long ones (84 minutes, two tests at a time)
	$(BIN)/pytest -n 2 --dist worksteal

bench: $(READY)  ## the benchmarks, into benchmarks/results/
	$(BIN)/python -m benchmarks all

validate: $(READY) ## figures of docs/real_machines.md: DATA=folder of the pump rig's records
	$(BIN)/python -m validation pump_rig $(DATA) --page docs/real_machines.md
	$(BIN)/python -m validation machines --page docs/real_machines.md

bench-guard: $(READY) ## compare speed with the last committed results
	$(BIN)/python -m benchmarks guard

docs: $(READY)   ## regenerate the config and table reference
	$(BIN)/python -m pipeline.cli.reference docs

docs-site: $(READY) ## the documentation as pages that can be browsed and searched, in site/
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict --quiet

pictures: report ## make the pictures of the README and the docs anew, from the demo
	$(BIN)/python -m tests.pictures out/report docs/pictures
	$(BIN)/python -m tests.notebooks .

wheelhouse: $(READY) ## all packages for an installation without a network, in wheelhouse/
	$(BIN)/python -m pip download --quiet --require-hashes -r requirements.txt -d wheelhouse
	$(BIN)/python -m pip wheel --quiet --no-deps --no-build-isolation -w wheelhouse .

clean:           ## remove the virtual environment and the demo's logs; tables stay
	rm -rf $(VENV) $(DEMO)
