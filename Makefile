# The first two commands on a fresh clone: `make demo`, then `make test`. `make help` lists the rest.
# Needs Python 3.11-3.13, make and git; everything else goes into a virtual environment in .venv.

PYTHON ?= python3
VENV   ?= .venv
OUT    ?= runs/demo_fig_2_7
JOBS   ?= 2
BIN    := $(VENV)/bin

# Small matrices: more threads per process only cost time.
export OMP_NUM_THREADS := 1
export OPENBLAS_NUM_THREADS := 1
export MKL_NUM_THREADS := 1
# Each process of the tests would compile a thousand modules again: what is compiled is kept in __pycache__.
unexport PYTHONDONTWRITEBYTECODE
# Figures are written to files; no display is needed.
export MPLBACKEND := Agg

PIP := $(BIN)/python -m pip --disable-pip-version-check --quiet install --constraint constraints.txt

.DEFAULT_GOAL := help
.PHONY: help demo test quick lint format graph pictures bench wheel lock hooks clean

help: ## this list
	@sed -n 's/^\([a-z]*\):.*## \(.*\)/make \1\t\2/p' $(MAKEFILE_LIST) | expand -t 16

demo: $(VENV)/.installed ## simulate Figure 2.7 of the thesis; prints the result table and where the report lies
	$(BIN)/forcectl run fig_2_7 --out $(OUT) --force

test: $(VENV)/.installed-test ## run all tests
	$(BIN)/python -m pytest -n $(JOBS) --dist worksteal

quick: $(VENV)/.installed-test ## run all tests but the slow ones, in some minutes
	$(BIN)/python -m pytest -n $(JOBS) --dist worksteal -m "not slow"

lint: $(VENV)/.installed-dev ## ruff, mypy, import-linter
	@failed=0; for check in "ruff check ." "ruff format --check ." mypy "lint-imports --no-logo"; do \
		echo "== $$check"; $(BIN)/$$check || failed=1; done; exit $$failed

format: $(VENV)/.installed-dev ## put the code into the agreed format
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

graph: $(VENV)/.installed ## draw the block diagram of Figure 2.7 as SVG and as an interactive page
	@mkdir -p runs
	$(BIN)/forcectl graph fig_2_7 --format svg --out runs/fig_2_7_diagram.svg
	$(BIN)/forcectl graph fig_2_7 --format html --out runs/fig_2_7_diagram.html

pictures: $(VENV)/.installed ## draw the README's pictures again
	@mkdir -p docs/images
	$(BIN)/forcectl run fig_2_7 --out runs/pictures --force
	cp runs/pictures/figures/force.png docs/images/fig_2_7.png
	$(BIN)/forcectl graph fig_2_7 --out docs/images/closed_loop.svg
	$(BIN)/python docs/pictures.py

bench: $(VENV)/.installed-test ## speed: import, build, real-time factors, cost per control tick
	@for script in benchmarks/[!_]*.py; do echo "== $$script"; $(BIN)/python "$$script" || exit 1; done

wheel: $(VENV)/.installed-dev ## build the wheel and the source archive into dist/
	rm -rf build dist
	$(BIN)/python -m build --outdir dist .

lock: ## resolve the dependencies again and rewrite constraints.txt and hashes.txt (needs all three Pythons)
	$(PYTHON) .ci/lock.py python3.11 python3.12 python3.13

hooks: $(VENV)/.installed-dev ## run the lint before every commit
	$(BIN)/pre-commit install

clean: ## remove the virtual environment, runs and everything built
	rm -rf $(VENV) build dist runs *.egg-info .*_cache .hypothesis
	find . -name __pycache__ -type d -prune -exec rm -rf {} +

# --- setting up: each stamp is made once, and again when the project's requirements change ---------------------------

CHECK_PYTHON := import sys; v = sys.version_info; \
	sys.exit(0 if (3, 11) <= v[:2] <= (3, 13) else "forcectl needs Python 3.11, 3.12 or 3.13, and $(PYTHON) is " \
	+ "%d.%d. Name another one, for example: make demo PYTHON=python3.12" % v[:2])

$(VENV)/.made:
	@command -v $(PYTHON) >/dev/null || { echo "$(PYTHON) was not found; forcectl needs Python 3.11, 3.12 or 3.13" >&2; exit 1; }
	@$(PYTHON) -c '$(CHECK_PYTHON)'
	$(PYTHON) -m venv $(VENV)
	@touch $@

$(VENV)/.installed: $(VENV)/.made pyproject.toml constraints.txt
	@echo "Installing Drake and the other packages into $(VENV); the first time this takes a few minutes ..."
	$(PIP) --editable .
	@touch $@

$(VENV)/.installed-test: $(VENV)/.installed
	$(PIP) --editable ".[sweep,test]"
	@touch $@

$(VENV)/.installed-dev: $(VENV)/.installed-test
	$(PIP) --editable ".[sweep,test,dev]"
	@touch $@
