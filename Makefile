# make setup | demo | gallery | reproduce | paper_search | test | bench | soak | lint | clean

VENV := .venv
BIN := $(VENV)/bin

# The ROS wheels exist for CPython 3.10 to 3.13, this package needs 3.11.
SUITABLE := import sys, venv; sys.exit(not (3, 11) <= sys.version_info[:2] <= (3, 13))
PYTHON ?= $(shell for python in python3 python3.13 python3.12 python3.11; do \
	$$python -c "$(SUITABLE)" 2>/dev/null && echo $$python && break; done)

# A sourced ROS installation would mix its libraries with the ROS wheels of the venv.
unexport PYTHONPATH LD_LIBRARY_PATH AMENT_PREFIX_PATH RMW_IMPLEMENTATION _ROS_WHEELS_BOOTSTRAP_COMPLETE

INSTALLED := $(VENV)/.installed
WARM := $(VENV)/.warm
NODE_READERS := test/node/node_modules/.installed

.PHONY: setup demo gallery reproduce paper_search test bench soak lint clean

setup: $(WARM)

demo: setup
	@$(BIN)/python scripts/demo.py --output demo

# docs/gallery.md and its pictures; needs Chromium and a Vulkan driver.
gallery: setup
	@$(BIN)/python scripts/gallery.py --output docs

# The source paper's numbers, claims and figures, beside ours.
reproduce: setup
	@$(BIN)/reproduce --output docs

# Whether other values of what the paper leaves open agree with more of it; ten minutes.
paper_search: setup
	@$(BIN)/python scripts/paper_search.py --trials paper_search --output docs/paper_search.md

test: setup $(NODE_READERS)
	@echo "== Running the test suite"
	@$(BIN)/pytest --numprocesses 2 --dist loadfile --durations 10

# Figures of an earlier commit stand beside today's; another one with make bench BEFORE=COMMIT.
bench: setup
	@$(BIN)/python benchmarks $(if $(BEFORE),--before $(BEFORE)) --output benchmarks/results.md --docs docs

# Ten minutes; others with make soak DURATION=60.
DURATION := 600
soak: setup
	@$(BIN)/python benchmarks/soak.py --duration $(DURATION) --output docs/soak.md

lint: setup
	@$(BIN)/ruff check .
	@$(BIN)/ruff format --check .
	@$(BIN)/mypy gear_dynamics_ros

clean:
	rm -rf $(VENV) build install log demo *.egg-info .pytest_cache .mypy_cache .ruff_cache test/node/node_modules
	find . -name __pycache__ -type d -prune -exec rm -rf {} +

$(INSTALLED): setup.py setup.cfg pyproject.toml constraints.txt
	@test -n "$(PYTHON)" && $(PYTHON) -c "$(SUITABLE)" 2>/dev/null || { \
		echo "make: no Python 3.11 to 3.13 at '$(PYTHON)'; install one, or name it: make PYTHON=/path/to/python3.12" >&2; \
		exit 1; }
	@test -x $(BIN)/python || { echo "== Creating $(VENV) with $$($(PYTHON) --version)"; $(PYTHON) -m venv $(VENV); } || { \
		rm -rf $(VENV); \
		echo "make: $(PYTHON) can't create a venv; on Debian and Ubuntu: apt-get install python3-venv" >&2; exit 1; }
	@echo "== Installing gear_dynamics_ros and the pinned packages it needs (1.6 GB on disk, a few minutes)"
	@$(BIN)/python -m pip install --disable-pip-version-check --progress-bar off --constraint constraints.txt setuptools
	@$(BIN)/python -m pip install --disable-pip-version-check --progress-bar off --constraint constraints.txt \
		--no-build-isolation --editable '.[ros,viewer,export,cluster,test,bench]'
	@touch $@

# The compiled kernel is cached beside its source; compiling it here keeps the first run short.
$(WARM): $(INSTALLED) $(wildcard gear_dynamics_ros/physics/*.py gear_dynamics_ros/physics/kernel/*.py)
	@echo "== Compiling the kernel (up to a minute, once)"
	@scratch=$$(mktemp -d) && trap 'rm -rf "$$scratch"' EXIT && \
		$(BIN)/simulate --params-file config/gearbox.yaml --duration 0.01 --output "$$scratch/warm"
	@touch $@
	@echo "== Ready"

# Recordings are also read in JavaScript, where Node.js is at hand; without it those tests are skipped.
$(NODE_READERS): test/node/package.json test/node/package-lock.json test/node/.npmrc
	@if ! node --eval "process.exit(parseInt(process.versions.node) < 18 ? 1 : 0)" 2>/dev/null || ! npm --version >/dev/null 2>&1; then \
		echo "== No Node.js 18 or later with npm here: recordings are not read in JavaScript"; \
	elif ! (cd $(<D) && npm ci --silent); then \
		echo "== npm can't install the readers of test/node: recordings are not read in JavaScript (to see why: cd test/node && npm ci)"; \
	else \
		touch $@; \
	fi
