# The two commands of a new user are `make reproduce-all` and `make test`; each sets up .venv first.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
# Of each configuration, for `make arithmetics`.
TRIALS ?= 20
CONFIGS := $(sort $(wildcard configs/*.yaml))
# Those whose alternatives take seconds.
QUICK := brouri_nonlinearity brouri_order chen_example6 chen_table3 chen_text chen_vif mzyk_left_out mzyk_reduction \
  mzyk_table1 mzyk_table1_as_printed mzyk_table1_grid mzyk_variance wang_table1 wang_table2

# Hundreds of processes start: without cached bytecode each takes a third longer.
unexport PYTHONDONTWRITEBYTECODE

.PHONY: help setup reproduce-all reproduce-part power site ledger test lint format arithmetics bench torture lock schema clean
.DEFAULT_GOAL := help

help: ## Show the targets
	@grep -hE '^[a-z-]+:.*## ' $(MAKEFILE_LIST) | sed -E 's/:.*## /\t/' | expand -t 16

setup: $(VENV)/ready ## Create .venv and install the locked versions into it

$(VENV)/ready: requirements.lock pyproject.toml
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
	  { echo "hident needs Python 3.11 or later; name one: make PYTHON=python3.12 $(MAKECMDGOALS)" >&2; exit 2; }
	@echo "setting up $(VENV) from requirements.lock"
	@$(PYTHON) -m venv --clear $(VENV)
	@$(BIN)/python -m pip install --quiet --disable-pip-version-check --require-hashes -r requirements.lock
	@$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-build-isolation --no-deps -e .
	@touch $@

reproduce-all: $(VENV)/ready ## Run every configuration, compare with results/, check the ledger
	@$(BIN)/hident run $(CONFIGS)
	@echo
	@$(BIN)/hident verify out --complete
	@echo
	@$(BIN)/hident compare out results --complete

reproduce-part: $(VENV)/ready ## Run at most 12 trials of every configuration and the quick alternatives, and compare
	@$(BIN)/hident run $(CONFIGS) --at-most 12
	@echo
	@$(BIN)/hident compare out results --complete --partial
	@echo
	@$(BIN)/hident power $(QUICK)
	@echo
	@$(BIN)/hident compare out/power results/power
	@echo
	@$(BIN)/hident verify results --complete

power: $(VENV)/ready ## Run every alternative, and compare with results/power
	@$(BIN)/hident power $(CONFIGS)
	@echo
	@$(BIN)/hident compare out/power results/power --complete

site: $(VENV)/ready ## Build the site of results/, and say where it is
	@$(BIN)/hident report results

ledger: site ## Write docs/ledger.svg anew, the picture in README.md
	@cp site/ledger.svg docs/ledger.svg

test: $(VENV)/ready ## Run the tests
	@workers=$$($(BIN)/python -c 'from hident.engine.cores import usable_cores; print(usable_cores())') && \
	  echo "testing all that is under tests/, on as many workers as cores are usable: $$workers" && \
	  $(BIN)/python -m pytest -n "$$workers" --dist worksteal

lint: $(VENV)/ready ## Check formatting, style and types
	@$(BIN)/ruff format --check .
	@$(BIN)/ruff check .
	@$(BIN)/mypy

format: $(VENV)/ready ## Format the code
	@$(BIN)/ruff format .
	@$(BIN)/ruff check --fix .

arithmetics: $(VENV)/ready ## Run every configuration with other kernels, and write the table in docs/
	@$(BIN)/python -m tests.arithmetics --trials $(TRIALS)

bench: $(VENV)/ready ## Measure speed and memory, and print ratios
	@$(BIN)/python -m tests.benchmarks

torture: $(VENV)/ready ## Kill, damage and starve runs, count what is lost (TORTURE="--only NAME --count N --seed S")
	@$(BIN)/python -m pytest -m long tests/robustness
	@$(BIN)/python -m tests.torture $(TORTURE)

schema: $(VENV)/ready ## Write docs/config.schema.json and docs/reference.md anew
	@$(BIN)/hident schema > docs/config.schema.json
	@$(BIN)/hident schema --markdown > docs/reference.md

lock: ## Resolve requirements.lock anew (needs uv)
	@uv pip compile pyproject.toml --extra dev --universal --python-version 3.11 --generate-hashes \
	  --no-header --no-emit-index-url --no-emit-find-links --quiet -o requirements.lock

clean: ## Remove the environment, outputs and caches; results/ and stored trials stay
	@rm -rf $(VENV) out site .site-cache build *.egg-info .mypy_cache .ruff_cache .hypothesis
	@find . -name __pycache__ -type d -prune -exec rm -rf {} +
