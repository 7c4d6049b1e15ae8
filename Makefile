# Every target makes its own virtual environment first, with what it needs of requirements/:
# nothing but Python >= 3.11, make and, for the tests, gcc has to be there.

PYTHON ?= python3
VENV   := .venv
BIN    := $(VENV)/bin
RUN    := $(VENV)/.run
DEV    := $(VENV)/.dev
DOCS   := $(VENV)/.docs
FULL   := $(VENV)/.full
DEMO   := demo

# Only variables that are set are passed on; the config decides the rest.
OPTIONS := $(if $(JOBS),--jobs $(JOBS)) $(if $(MOTORS),--motors "$(MOTORS)") $(if $(SINCE),--since $(SINCE)) $(if $(UNTIL),--until $(UNTIL))

.PHONY: help install fit-fleet look report check demo-logs lint format test test-full bench bench-guard validate docs \
        docs-site pictures requirements wheelhouse clean

help:            ## list of targets
	@grep -E '^[a-z-]+:.*##' $(MAKEFILE_LIST) | sed -E 's/:[^#]*## */\t/' | expand -t 14

install: $(RUN)  ## the virtual environment with what the program needs

# Bytecode is of what is imported, then: a tenth of the modules.
INSTALL := $(BIN)/python -m pip install --quiet --disable-pip-version-check --no-compile
export PYTHONDONTWRITEBYTECODE :=

$(RUN): requirements/run.txt pyproject.toml
	$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "Python 3.11 or newer is needed; say make PYTHON=...")'
	@echo "installing the program's packages into $(VENV)/: about a minute, once"
	$(PYTHON) -m venv $(VENV)
	$(INSTALL) --require-hashes -r $<
	$(INSTALL) --no-deps --no-build-isolation -e .
	@touch $@

$(DEV): requirements/dev.txt $(RUN)
$(DOCS): requirements/docs.txt $(DEV)
$(FULL): requirements/full.txt $(DOCS)

$(DEV) $(DOCS) $(FULL):
	$(INSTALL) --require-hashes -r $<
	@touch $@

# The demo's logs are made where no fleet is named.
ifdef CONFIG
FLEET := $(CONFIG)
else
FLEET := configs/fleet.toml
fit-fleet report check look: demo-logs
report: fit-fleet
endif

fit-fleet: $(RUN) ## fit a fleet: CONFIG=configs/fleet.toml JOBS=4 MOTORS="A B" SINCE=2026-01-01 UNTIL=...
	$(BIN)/motor-leakage fit-fleet $(FLEET) $(OPTIONS)

look: $(RUN)   ## intraday check of growing logs: CONFIG=... EVERY=10min
	$(BIN)/motor-leakage look $(FLEET) $(if $(EVERY),--every $(EVERY)) $(if $(MOTORS),--motors "$(MOTORS)")

report: $(RUN) ## pages of the fleet and its motors: CONFIG=configs/fleet.toml
	$(BIN)/motor-leakage report $(FLEET)

check: $(RUN)  ## check a fleet's config and the head of its logs: CONFIG=...
	$(BIN)/motor-leakage check $(FLEET)

demo-logs: $(DEMO)/truth.json ## simulated logs of the six motors of configs/fleet.toml, in demo/

$(DEMO)/truth.json: | $(RUN)
	@echo "simulating 75 nights of six motors into $(DEMO)/: about 20 seconds, once"
	$(BIN)/motor-leakage demo . $(if $(LAST_NIGHT),--last-night $(LAST_NIGHT))

lint: $(DEV)     ## style, types, law of imports, and up-to-date docs
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports
	$(BIN)/python -m tests.reference_pages --check docs

format: $(DEV)
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

# Three at a time on two cores: a quarter of their time is waiting for processes and limits. In
# the order of their names: the short files of tests/ itself fill the end.
test: $(DEV)   ## the tests of every change
	$(BIN)/pytest -n 3 --dist loadfile --no-loadscope-reorder -m "not full"

test-full: $(FULL) ## all tests, with the long ones (84 minutes, two tests at a time)
	$(BIN)/pytest -n 2 --dist worksteal

bench: $(FULL)  ## the benchmarks, into benchmarks/results/
	$(BIN)/python -m benchmarks all

validate: $(FULL) ## figures of docs/evidence.md: DATA=folder of the pump rig's records
	$(BIN)/python -m validation pump_rig $(DATA) --page docs/evidence.md
	$(BIN)/python -m validation machines --page docs/evidence.md

bench-guard: $(DEV) ## compare speed with the last committed results
	$(BIN)/python -m benchmarks guard

docs: $(DEV)   ## regenerate the config and table reference
	$(BIN)/python -m tests.reference_pages docs

docs-site: $(DOCS) ## the documentation as pages that can be browsed and searched, in site/
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict --quiet

# Pictures and pages of the docs are those of one demo, whenever they are made.
pictures: LAST_NIGHT := 2026-03-17
pictures: report $(DOCS) ## make the pictures of the README and the docs anew, from the demo
	$(BIN)/python -m tests.pictures out/report docs/pictures
	$(BIN)/python -m tests.notebooks .

# Exact versions with hashes. Those that are there stay; `make requirements UPGRADE=--upgrade` takes
# the newest. A file begins with another one, whose packages it leaves out; those of other systems
# alone it has again.
UV    := $(VENV)-uv/bin/uv
PINS   = $(UV) pip compile pyproject.toml --universal --python-version 3.11 --generate-hashes --quiet \
         --no-emit-index-url --no-header --no-annotate $(UPGRADE) -o requirements/$(1).txt
BEYOND = -c requirements/run.txt $(2:%=-c requirements/%.txt) \
         $$(sed -nE 's/^([a-z0-9.-]+)==[^ ]+ (; python_full_version [^ ]+ [^ ]+ )?.$$/--no-emit-package \1/p' requirements/run.txt $(2:%=requirements/%.txt))

requirements:    ## make the pins of requirements/ anew of pyproject.toml
	$(PYTHON) -m venv $(VENV)-uv
	$(VENV)-uv/bin/pip install --quiet --disable-pip-version-check uv
	$(call PINS,run) --group build
	$(call PINS,dev) --group dev $(addprefix --extra ,dask protobuf s3) $(call BEYOND)
	sed -i '1i -r run.txt' requirements/dev.txt
	$(call PINS,docs) --group docs $(call BEYOND,,dev)
	sed -i '1i -r dev.txt' requirements/docs.txt
	$(call PINS,full) --group full $(call BEYOND,,dev docs)
	sed -i '1i -r docs.txt' requirements/full.txt
	$(call PINS,image) $(addprefix --extra ,dask protobuf s3) -c requirements/dev.txt $(call BEYOND)
	sed -i '1i -r run.txt' requirements/image.txt

wheelhouse: $(DEV) ## all packages for an installation without a network, in wheelhouse/
	$(BIN)/python -m pip download --quiet --require-hashes -r requirements/dev.txt -d wheelhouse
	$(BIN)/python -m pip wheel --quiet --no-deps --no-build-isolation -w wheelhouse .
	rm -rf build

clean:           ## remove the virtual environment and the demo's logs; tables stay
	rm -rf $(VENV) $(DEMO)
