# Targets for newcomers: `make reproduce` and `make test`; `make help` lists all.
SHELL := /bin/bash
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
PRESET ?= default
DATA ?= $(or $(FPLOC_DATA),data)
RUNS ?= runs
WORKERS ?= 2
ZERO_SHOT_SITES := shopping-mall laboratory library conference-room
MODEL_SITES := office,office-position1,office-position2,conference-room,laboratory,library,shopping-mall

# Small batches on few cores: one thread each is faster than threads that wait for each other spinning.
export OMP_NUM_THREADS ?= 1
export MLFLOW_DISABLE_TELEMETRY := true
export MLFLOW_SERVER_ENABLE_JOB_EXECUTION := false

.DEFAULT_GOAL := help
.PHONY: help install reproduce test coverage mutants lint ui notebooks model results describe docs docs-serve picture demo soak
.PHONY: lock wheel clean

help: ## List every target
	@grep -hE '^[a-z-]+:.*## ' $(MAKEFILE_LIST) | awk -F ':.*## ' '{printf "  make %-11s %s\n", $$1, $$2}'

install: $(VENV)/installed ## Create the environment in .venv and install everything (3 to 5 minutes)
	@:

$(VENV)/installed: pyproject.toml constraints.txt
	@echo "Installing into $(VENV): 3 to 5 minutes, about 7 GB"
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e '.[all,dev]'
	@touch $@

reproduce: install ## Get data, train, evaluate, tabulate; PRESET=smoke|default|full|published|paper; resumes
	@$(BIN)/fploc reproduce --preset $(PRESET) --data-root $(DATA) --runs $(RUNS) --workers $(WORKERS)

test: install ## Run the whole test suite (under 15 minutes)
	@$(BIN)/python -m pytest -n 2 --dist loadfile

coverage: install ## Run the whole test suite and say which branches it reaches: at least 90 % (20 minutes)
	@$(BIN)/python -m pytest -n 2 --dist loadfile --cov --cov-report=term --cov-report=json:$(RUNS)/coverage.json

mutants: install ## Change the code in 300 places and count what the tests notice: at least 80 % (30 minutes)
	@$(BIN)/python benchmarks/mutants.py --processes $(WORKERS) --out $(RUNS)/mutants.json

lint: install ## Format check, lint, types, direction of imports
	@$(BIN)/ruff format --check .
	@$(BIN)/ruff check .
	@$(BIN)/mypy
	@$(BIN)/lint-imports

ui: install ## Open the MLflow comparison on http://127.0.0.1:5000
	@$(BIN)/mlflow server --backend-store-uri sqlite:///$(abspath $(RUNS))/mlflow.db \
		--default-artifact-root $(abspath $(RUNS))/mlflow-artifacts --host 127.0.0.1 --port 5000 --workers 1

notebooks: install ## Execute the notebooks on the packed sites and the results under runs/
	@FPLOC_DATA=$(abspath $(DATA)) FPLOC_RUNS=$(abspath $(RUNS)) $(BIN)/python -m pytest --nbmake --nbmake-timeout=1200 notebooks -o testpaths=notebooks

model: install ## Train the default method: what ships, and without each place (20 minutes)
	@$(BIN)/fploc data build --data-root $(DATA) --sites $(MODEL_SITES)
	@$(BIN)/fploc model --data-root $(DATA) --runs $(RUNS) --out fploc/pretrained

results: install ## Write docs/results.md from finished runs of the presets full and published
	@$(BIN)/python benchmarks/virtual_stream.py --data-root $(DATA) --json > $(RUNS)/virtual-stream.json
	@$(BIN)/fploc bench --site shopping-mall --preset full --data-root $(DATA) --runs $(RUNS) --json > $(RUNS)/bench.json
	@$(BIN)/python benchmarks/plan_worth.py --data-root $(DATA) --json > $(RUNS)/plan-worth.json
	@for site in $(ZERO_SHOT_SITES); do $(BIN)/fploc evaluate --method default --protocol zero-shot --site $$site \
	  --labels repaired --smoother --data-root $(DATA) --json $(RUNS)/offline-$$site.jsonl > /dev/null || exit 1; done
	@cat $(ZERO_SHOT_SITES:%=$(RUNS)/offline-%.jsonl) > $(RUNS)/offline.jsonl
	@$(BIN)/python -m fploc.experiments.results_docs $(RUNS) docs

describe: install ## Count what the packed sites hold and write their data cards
	@$(BIN)/fploc data describe --data-root $(DATA) --out $(RUNS)/data-cards

demo: install ## A made-up building, a server and four simulated phones on a map: http://127.0.0.1:8000
	@$(BIN)/python -m fploc.serve.demo --folder $(RUNS)/demo

soak: install ## Load the server for minutes, more and more, kill it 20 times, watch the map; docs/load.md (20 minutes)
	@$(BIN)/python soak/load.py --devices 50 --seconds 300 --out $(RUNS)/soak/steady.json
	@$(BIN)/python soak/load.py --devices 10,25,50,75,100,150,200,300,400 --seconds 30 --out $(RUNS)/soak/curve.json
	@$(BIN)/python soak/kills.py --kills 20 --out $(RUNS)/soak/kills.json
	@$(BIN)/python soak/browser.py --devices 200 --seconds 30 --out $(RUNS)/soak/browser.json
	@$(BIN)/python soak/load_page.py $(RUNS)/soak docs --note "Measured on $$(nproc --all) cores."

docs: install ## Build the documentation into build/docs, warnings as errors
	@NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --quiet --strict
	@echo "documentation: build/docs/index.html"

docs-serve: install ## Show the documentation on http://127.0.0.1:8001 while its pages are written
	@NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs serve --dev-addr 127.0.0.1:8001

picture: install ## Draw the picture of README.md anew
	@$(BIN)/python docs/images/made_up.py

lock: install ## Resolve the ranges of pyproject.toml anew and write constraints.txt
	@$(BIN)/python -m pip install --quiet --upgrade -e '.[all,dev]'
	@$(BIN)/python -m pip freeze --exclude-editable --exclude fploc | grep -E '^[A-Za-z0-9._-]+==' > constraints.txt

wheel: install ## Build the wheel into dist/
	@$(BIN)/python -m build --wheel --outdir dist

clean: ## Remove the environment and everything made (not the data)
	rm -rf $(VENV) build dist runs mutants .coverage* .pytest_cache .mypy_cache .ruff_cache
