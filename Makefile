# The commands of the project. Each makes what it needs: a virtual environment in .venv with
# the versions pinned in constraints.txt. Needs Python 3.11 or newer with its venv module, and make.

PYTHON ?= $(firstword $(foreach p,python3.11 python3.12 python3.13 python3,$(if $(shell $(p) -c 'import sys, ensurepip; sys.exit(sys.version_info < (3, 11))' 2>/dev/null && echo ok),$(p))))
VENV := .venv
BIN := $(VENV)/bin
export PIP_DISABLE_PIP_VERSION_CHECK := 1

.PHONY: demo test lint format bench sample-logs clean

demo: $(VENV)/installed
	$(BIN)/specmap build sample_logs/office.mcap --out demo/map --overwrite
	$(BIN)/specmap localize sample_logs/office_again.mcap --map demo/map --output demo/office_again.csv --plot demo/office_again.png --metric --overwrite
	@echo "The map is in demo/map (look at demo/map/overview.png); where the second log was taken: demo/office_again.csv, demo/office_again.png"

test: lint
	$(BIN)/python -m pytest -n 2

lint: $(VENV)/installed-dev
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

format: $(VENV)/installed-dev
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

bench: $(VENV)/installed-dev
	$(BIN)/python -m benchmarks.speed
	$(BIN)/python -m benchmarks.registration
	$(BIN)/python -m benchmarks.rooms
	$(BIN)/python -m benchmarks.online
	$(BIN)/python -m benchmarks.recognition

sample-logs: $(VENV)/installed
	$(BIN)/python sample_logs/draw_office.py
	$(BIN)/specmap simulate sample_logs/office.yaml -o sample_logs/office.mcap --beams 181 --speed 0.8 --spacing 3 --laps 2 --seed 2 --overwrite
	$(BIN)/specmap simulate sample_logs/office.yaml -o sample_logs/office_again.mcap --beams 181 --speed 0.8 --spacing 3 --seed 7 --overwrite

clean:
	rm -rf $(VENV) demo .pytest_cache .mypy_cache .ruff_cache .hypothesis

$(VENV)/created:
	@if [ -z "$(PYTHON)" ]; then echo "make: no Python 3.11 or newer with the venv module found: install python3 and python3-venv, or say make PYTHON=/path/to/python3" >&2; exit 2; fi
	$(PYTHON) -m venv $(VENV)
	@touch $@

$(VENV)/installed: $(VENV)/created pyproject.toml constraints.txt
	$(BIN)/python -m pip install --quiet --constraint constraints.txt --editable .
	@touch $@

$(VENV)/installed-dev: $(VENV)/installed
	$(BIN)/python -m pip install --quiet --constraint constraints.txt --editable '.[dev]'
	@touch $@
