PYTHON ?= python3
VENV ?= .venv
BIN := $(VENV)/bin
# The variables constrain what pip installs for the build itself, older and newer pips; -c does not.
PIP_INSTALL := PIP_CONSTRAINT=constraints.txt PIP_BUILD_CONSTRAINT=constraints.txt $(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt

# The tests start many processes, and each would compile all modules again.
unexport PYTHONDONTWRITEBYTECODE

.PHONY: help run play test coverage test-slow test-long wheel trainers parity soak torture docs release-check lint format clean

help:
	@echo "make run        learn a driver and an HMI in two stages, make their table and a clip"
	@echo "make play       open a page on which you drive with an HMI, or are one"
	@echo "make test       run the tests"
	@echo "make coverage   run them with their lines counted: at least 95 % of the package"
	@echo "make test-slow  run what make test leaves out: long statistics, whole sizes, every pair"
	@echo "make test-long  run what is too long for make test-slow: whole training, hundreds of seeds"
	@echo "make wheel      install the wheel with each extra alone, and run everything it promises"
	@echo "make trainers   test RLlib, TorchRL, Tianshou and AgileRL, each in an environment of its own"
	@echo "make parity     compare the batched world with highway-env, for hundreds of seeds"
	@echo "make soak       ten million random team steps over any settings, 200 episodes in both worlds"
	@echo "make torture    kill, interrupt and starve commands at random moments, and compare what they leave"
	@echo "make docs       the documentation site, in site/"
	@echo "make release-check  whether this commit can be released, or what is left to do"
	@echo "make lint       ruff, mypy and the contracts for imports"
	@echo "make format     format the code with ruff"
	@echo "make clean      remove $(VENV) and what was made"

run: $(VENV)/.for-run
	$(BIN)/hmi-marl train two-stage --driver-steps 4_000_000 --hmi-steps 600_000 --out runs/first
	$(BIN)/hmi-marl table --hmis NoHMI AvgHMI own runs/first --driver-policy runs/first \
	  --world batched --episodes 256

play: $(VENV)/.for-play
	$(BIN)/hmi-marl play --open

test: $(VENV)/.for-test
	OMP_NUM_THREADS=1 $(BIN)/python -m pytest -n 2 --dist worksteal

coverage: $(VENV)/.for-test
	OMP_NUM_THREADS=1 $(BIN)/python -m pytest -n 2 --dist worksteal --cov --cov-report=term:skip-covered --cov-fail-under=95

test-slow: $(VENV)/.for-test
	OMP_NUM_THREADS=1 $(BIN)/python -m pytest -n 2 --dist worksteal -m "slow and not long"

test-long: $(VENV)/.for-test
	OMP_NUM_THREADS=1 $(BIN)/python -m pytest -n 2 --dist worksteal -m long

wheel: $(VENV)/.for-test
	OMP_NUM_THREADS=1 $(BIN)/python -m pytest -n 2 --dist loadgroup -m wheel tests/installed

trainers: $(BIN)/python
	OMP_NUM_THREADS=1 $(BIN)/python tests/trainers/run.py

parity: $(VENV)/.for-test
	$(BIN)/python -m pytest -n 2 -m "not wheel" -k follows_highway_env tests/envs/worlds

soak: $(VENV)/.for-test
	$(BIN)/python -m pytest -n 0 -m long -k ten_million tests/envs/worlds

torture: $(VENV)/.for-test
	OMP_NUM_THREADS=1 $(BIN)/python tests/torture $(TORTURE)

docs: $(VENV)/.for-docs
	$(BIN)/python docs/making
	@echo "open site/index.html"

release-check: $(VENV)/.for-test
	$(BIN)/python tests/release.py

lint: $(VENV)/.for-test
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

format: $(VENV)/.for-test
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

clean:
	rm -rf $(VENV) runs site build dist .coverage .import_linter_cache .mypy_cache .pytest_cache .ruff_cache .hypothesis

$(BIN)/python:
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
	  { echo "hmi-marl needs Python 3.11 or newer: make PYTHON=/path/to/python3.11 ..."; exit 1; }
	$(PYTHON) -m venv $(VENV)

$(VENV)/.for-run: pyproject.toml constraints.txt | $(BIN)/python
	$(PIP_INSTALL) torch
	$(PIP_INSTALL) -e '.[train]'
	touch $@

$(VENV)/.for-play: pyproject.toml constraints.txt | $(BIN)/python
	$(PIP_INSTALL) -e '.[people]'
	touch $@

$(VENV)/.for-test: pyproject.toml constraints.txt | $(BIN)/python
	$(PIP_INSTALL) torch
	$(PIP_INSTALL) -e '.[video,train,interop,data,ray,people,docs,dev]'
	touch $@

$(VENV)/.for-docs: pyproject.toml constraints.txt | $(BIN)/python
	$(PIP_INSTALL) -e '.[docs]'
	touch $@
