# One command for everything. `make` alone lists them.
SHELL := /bin/bash
.DEFAULT_GOAL := help
.PHONY: help setup test slow repeat fuzz demo docs site results commands bench lint format colcon wheels clean

BIN  := .venv/bin
# Workers of the test run; `make test JOBS=1` runs in one process. One more than cores: a third of the time tests wait.
JOBS ?= $(shell n=$$(nproc 2>/dev/null || echo 1); echo $$((n > 7 ? 8 : n + 1)))
# More for the command behind a target: make test ARGS="-k frames", make demo ARGS="--help"
ARGS ?=
# make repeat: how often the whole suite runs, and how often the part that starts processes
N ?= 8
PROCESSES ?= 30
# The interpreter for .venv: make setup PYTHON=python3.12
export PYTHON ?=

help:  ## List the targets
	@awk -F':.*## ' '/^[a-z]+:.*## /{printf "  make %-8s %s\n", $$1, $$2}' $(MAKEFILE_LIST)

setup:  ## Make .venv with what flying needs; the targets below add what they need to it
	@requirements/setup.sh

# What a target needs besides: setup-test adds the packages of tests, setup-messages builds what the wheels of ROS lack,
# setup-test-messages does both at once.
setup-%:
	@requirements/setup.sh $(subst -, ,$*)

# Jazzy leaves field type checks off: Point().x = 1 would be sent as 5e-324.
test slow repeat: export ROS_PYTHON_CHECK_FIELDS := 1
test slow repeat: export ROS_AUTOMATIC_DISCOVERY_RANGE ?= LOCALHOST
# Containers tend to set it: every process of the tests would compile every module of ours.
test slow repeat: export PYTHONDONTWRITEBYTECODE :=
test: setup-test-site-messages  ## Run the quick tests, those in real time last, and say why any are skipped
	@time $(BIN)/python tests/run.py quick $(JOBS) $(ARGS)

slow: setup-test-site-messages  ## Run the tests that take more than five seconds each, such as flights of processes
	@time $(BIN)/python tests/run.py slow $(JOBS)

repeat: setup-test-site-messages  ## Run the quick tests N times, every second time beside busy loops
	@$(BIN)/python tests/repeat.py $(N) $(PROCESSES) $(JOBS) $(ARGS)

fuzz: setup  ## Mutated bags, scenarios, files, messages and packets: make fuzz ARGS="--seconds 600"
	@time $(BIN)/python -m bench.fuzz --seconds 60 $(ARGS)

demo: setup  ## Fly a formation, record it, verify it
	@time $(BIN)/ptnsbc demo $(ARGS)

docs: setup  ## Make the parts of the pages that are made of the code
	@$(BIN)/python -m docs.make $(ARGS)

site: setup-site  ## Build all pages as a site, searched without a network: build/site
	@$(BIN)/python -m docs.make.site $(ARGS)

results: setup  ## Fly the paper again: docs/results.md, tables.md and their pictures
	@time $(BIN)/ptnsbc reproduce --docs docs $(ARGS)

families: setup  ## Draw and search every shipped family: docs/shares.md. Hours, and goes on where it ended
	@time $(BIN)/python -m paper.families $(ARGS) && $(BIN)/python -m docs.make

commands: setup-test-messages  ## Run every command in README and docs, in a scratch clone
	@time $(BIN)/python -m docs.commands $(ARGS)

bench: setup  ## Measure the figures that the pages quote
	@time $(BIN)/python -m bench $(ARGS)

lint: setup-lint  ## ruff (style, layering), formatting, mypy, nothing newer than Python 3.10; docker/
	@time { $(BIN)/ruff check . && $(BIN)/ruff format --check . && $(BIN)/mypy; }
	@$(BIN)/vermin --quiet --no-tips --violations -t=3.10- --exclude operator.call $$(git ls-files '*.py')
	@$(BIN)/hadolint docker/Dockerfile
	@$(BIN)/check-jsonschema --builtin-schema vendor.compose-spec docker/compose.yaml

format: setup-lint  ## Let ruff format the code and fix what it can
	@$(BIN)/ruff format . && $(BIN)/ruff check --fix .

colcon: setup-colcon-messages  ## Build the ROS workspace from a clean copy, fly from what is installed, compare with pip
	@time ros2_ws/fly.sh

wheels:  ## Wheels of the message packages in dist/, for each Python 3.10 to 3.13 here: install them where no compiler is
	@requirements/interfaces/wheels.sh

clean:  ## Remove .venv and everything built
	rm -rf .venv .venv.lock build dist *.egg-info out ros2_ws/{build,install,log} .mypy_cache .pytest_cache .ruff_cache
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
