# Everything below sets itself up: a Python 3.11 with venv, make and a package index are enough.
PYTHON ?= $(shell command -v python3.11 || command -v python3)
BIN := .venv/bin
SEED ?= 1
SESSION ?= docs/example/session.mcap
VIEWER := $(if $(VIEW),$(if $(filter web,$(VIEW)),web,native),file)
INSTALL := $(BIN)/python -m pip install --quiet --disable-pip-version-check
LOCK := $(BIN)/pip-compile --quiet --generate-hashes --allow-unsafe --strip-extras --no-header \
	--no-emit-index-url --no-emit-find-links --no-emit-trusted-host --no-annotate

# Markers that make test leaves to make test-all, which pyproject.toml explains. What is essential is in both.
LATER := rig or hosts or browser or renders or fuzz or slow
PROCESSES := rig or hosts or browser
# more than cores, for many tests wait; the tests of a file share fixtures, and stay together
PARALLEL := -n $(shell echo $$(($$(getconf _NPROCESSORS_ONLN) * 3 / 2))) --dist loadfile
ESSENTIAL := $(shell grep -rl --include='*.py' mark.essential tests)
PYTEST := $(BIN)/python -m pytest
# a process that a test starts counts for that test; tests may take longer than without
COVERAGE := $(PYTEST) --cov --cov-context=test --cov-report= -o junit_family=xunit1 --timeout=500 \
	-W ignore::coverage.exceptions.CoverageWarning

.PHONY: help install demo play look example test test-all coverage bless check format protos lock sim clean
help: ## this list
	@grep -hE '^[a-z]+:.*##' $(MAKEFILE_LIST) | sed 's/:.*## /\t/' | expand -t 12

demo: .venv/runtime.done ## a simulated grasp from image to judgement, in under a minute; SEED=2, VIEW=1, VIEW=web
	@$(BIN)/suturegrasp demo --seed $(SEED) --view $(VIEWER)

install: .venv/runtime.done ## what a machine of a rig needs (docs/deployment.md)

play: .venv/runtime.done ## the simulated rig with the operator's page, running until Ctrl-C; PORT=7450
	@$(BIN)/suturegrasp play --port $(or $(PORT),7450)

look: .venv/runtime.done ## a recorded grasp that failed, on Rerun's timeline (docs/debugging.md); SESSION=session.mcap
ifeq ($(DISPLAY)$(WAYLAND_DISPLAY),)
	@mkdir -p out
	@$(BIN)/suturegrasp view "$(SESSION)" --layout grasp --output out/session.rrd
	@echo "no screen here; where there is one:  .venv/bin/rerun out/session.rrd"
else
	@$(BIN)/suturegrasp view "$(SESSION)" --layout grasp
endif

example: .venv/runtime.done ## a stereo pair becomes a thread in 3D, in a few seconds
	@mkdir -p out
	@$(BIN)/suturegrasp reconstruct --left docs/example/left.png --right docs/example/right.png \
		--calibration docs/example/calibration.json \
		--output out/thread.json --picture out/thread.png --rrd out/thread.rrd
	@echo "Look at out/thread.png, or in 3D:  .venv/bin/rerun out/thread.rrd"

# as agents do: threads of one computation that wait for each other's turn on two busy cores cost more than they gain
test test-all coverage: export OPENBLAS_NUM_THREADS := 1
test test-all coverage: export OPENCV_FOR_THREADS_NUM := 1
# some machines forbid it to all programs; hundreds of processes would compile everything anew
test test-all coverage: export PYTHONDONTWRITEBYTECODE :=
# the rigs first and alone, for they have limits; then what computes, in parallel
test: .venv/dev.done ## in some two minutes: all that computes; a demo, an arm that is held, a router that is killed; ARGS="..." for some
ifeq ($(ARGS),)
	@$(PYTEST) -o cache_dir=.pytest_cache/essential -m essential $(ESSENTIAL); rigs=$$?; \
	$(PYTEST) $(PARALLEL) -m "not ($(LATER))"; exit $$((rigs + $$?))
else
	@$(PYTEST) $(ARGS)
endif

# the other rigs run one at a time: their limits are those of a rig that has the machine
test-all: .venv/dev.done ## make test, then whole rigs, hosts, browsers, renders, fuzzing
	@$(MAKE) --no-print-directory test; first=$$?; \
	$(PYTEST) $(PARALLEL) -o cache_dir=.pytest_cache/later -m "($(LATER)) and not ($(PROCESSES) or essential)"; later=$$?; \
	$(PYTEST) -o cache_dir=.pytest_cache/processes -m "($(PROCESSES)) and not essential"; exit $$((first + later + $$?))

coverage: .venv/dev.done ## lines and branches that make test-all runs, by which test: out/coverage
	@rm -rf out/coverage; mkdir -p out/coverage
	@$(COVERAGE) --junit-xml=out/coverage/computing.xml $(PARALLEL) -m "not ($(PROCESSES))"; \
	$(COVERAGE) --cov-append --junit-xml=out/coverage/processes.xml -m "$(PROCESSES)"; \
	$(BIN)/coverage report --skip-covered --sort=cover > out/coverage/report.txt; grep TOTAL out/coverage/report.txt

bless: .venv/dev.done ## what the agents make of the golden recordings now is right from now on; shows what changed
	@$(BIN)/python -m tests.goldens.bless

check: .venv/dev.done ## format, lint, types, layers, the safety case
	@$(BIN)/ruff format --check .
	@$(BIN)/ruff check .
	@$(BIN)/basedpyright --level error
	@$(BIN)/lint-imports --no-cache
	@$(BIN)/python -m tests.safety_case

format: .venv/dev.done ## rewrite in the project's format
	@$(BIN)/ruff format .
	@$(BIN)/ruff check --fix .

protos: .venv/dev.done ## write schemas/suturegrasp.proto and .desc, for other programs, from the messages
	@$(BIN)/python -m schemas.wire

lock: .venv/dev.done ## renew requirements/*.lock (names, versions and hashes only)
	@$(LOCK) --extra build --output-file requirements/runtime.lock pyproject.toml
	@$(LOCK) --extra build --extra dev --output-file requirements/dev.lock pyproject.toml
	@cp requirements/runtime.lock requirements/sim.lock # what both need, in the same versions
	@$(LOCK) --extra build --extra sim --output-file requirements/sim.lock pyproject.toml

sim: .venv/sim.done ## path tracer and contact physics, for suturegrasp scenes render and evaluate grasping

clean: ## remove the virtual environment and outputs
	@rm -rf .venv out

.venv/bin/python:
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
		{ echo "SutureGrasp needs Python 3.11 or newer; found $$($(PYTHON) --version). Try: make PYTHON=/path/to/python3.11" >&2; exit 2; }
	@$(PYTHON) -m venv .venv

.venv/runtime.done: requirements/runtime.lock pyproject.toml schemas/__init__.py | .venv/bin/python
	@echo "installing (once) ..."
	@$(INSTALL) --require-hashes -r requirements/runtime.lock
	@$(INSTALL) --no-deps --no-build-isolation --editable .
	@touch $@

.venv/dev.done: requirements/dev.lock .venv/runtime.done
	@echo "installing the development tools (once) ..."
	@$(INSTALL) --require-hashes -r requirements/dev.lock
	@touch $@

.venv/sim.done: requirements/sim.lock .venv/runtime.done
	@echo "installing the path tracer and contact physics (once) ..."
	@$(INSTALL) --require-hashes -r requirements/sim.lock
	@touch $@
