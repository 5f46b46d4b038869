# The commands of the project. Each makes what it needs: a virtual environment in .venv with the
# versions pinned in constraints.txt, and one in .venv-lowest with the lowest that pyproject.toml
# allows, pinned in constraints-lowest.txt. Needs Python 3.11 or newer with its venv module, and
# make; the lowest versions need Python 3.11, the lowest itself.

PYTHON ?= $(firstword $(foreach p,python3.11 python3.12 python3.13 python3,$(if $(shell $(p) -c 'import sys, ensurepip; sys.exit(sys.version_info < (3, 11))' 2>/dev/null && echo ok),$(p))))
PYTHON_LOWEST ?= python3.11
VENV := .venv
BIN := $(VENV)/bin
LOWEST := .venv-lowest
export PIP_DISABLE_PIP_VERSION_CHECK := 1
# Compiled modules are kept: else each of the many processes of the tests compiles all of them.
unexport PYTHONDONTWRITEBYTECODE
# A file of tests stays with one worker, which makes once what its tests share.
PYTEST := -m pytest -n 2 --dist loadfile

.PHONY: demo paper pictures docs dist release test pytest test-lowest lint ruff mypy format scoreboard fuzz sample-logs constraints-lowest clean

demo: $(VENV)/installed
	$(BIN)/specmap build sample_logs/office.mcap --out demo/map --overwrite
	$(BIN)/specmap localize sample_logs/office_again.mcap --map demo/map --out demo/office_again.csv --plot demo/office_again.png --metric --overwrite
	@echo "The map is in demo/map (look at demo/map/overview.png); where the second log was taken: demo/office_again.csv, demo/office_again.png"

# Types are checked beside the tests: mypy has work for half a minute and for one processor.
test: ruff
	@$(MAKE) --no-print-directory --jobs=2 mypy pytest
	@$(BIN)/python -m benchmarks.scoreboard --state

pytest: $(VENV)/installed-dev
	$(BIN)/python $(PYTEST)

# What no version of a library can change is left out: CONTRIBUTING.md says what, and why.
SAME_FOR_ALL := tests/test_architecture.py tests/test_dependencies.py tests/test_docs.py tests/fuzz tests/paper
test-lowest: $(LOWEST)/installed-dev
	$(LOWEST)/bin/python $(PYTEST) $(addprefix --ignore=,$(SAME_FOR_ALL))

lint: ruff mypy

ruff: $(VENV)/installed-dev
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

mypy: $(VENV)/installed-dev
	$(BIN)/mypy

format: $(VENV)/installed-dev
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

# Every figure of this tree on one page: some 45 minutes on two processors, nothing beside it. SPECMAP_DATA
# names the folder with the real recordings. `python -m benchmarks.scoreboard --help` has more.
scoreboard: $(VENV)/installed-dev
	$(BIN)/python -m benchmarks.scoreboard

# Every table and figure of the paper on one page, computed anew: 20 minutes. SPECMAP_DATA names the
# folder with the real recordings; without it only simulated buildings are shown.
paper: $(VENV)/installed-dev
	$(BIN)/python -m benchmarks.paper --out paper

# A mutation fuzzer of our own over logs and maps, pairs of commands on one map, then the tests of
# random inputs with many cases each: see docs/reliability.md.
CASES ?= 20000
PAIRS ?= 20
SEED ?= 1
JOBS ?= 2
fuzz: $(VENV)/installed-dev
	$(BIN)/python -m fuzz --cases $(CASES) --seed $(SEED) --jobs $(JOBS)
	$(BIN)/specmap build sample_logs/office.mcap -o build/fuzz/map --overwrite --quiet
	$(BIN)/python -m fuzz.pairs build/fuzz/map sample_logs/office_again.mcap --count $(PAIRS) --seed $(SEED)
	SPECMAP_CASES=many $(BIN)/python $(PYTEST) -m hypothesis --hypothesis-seed=$(SEED)
	SPECMAP_CASES=many $(BIN)/python $(PYTEST) tests/logs/readers/test_nothing_lost.py

# The site of the documents, in site/: every link is checked.
docs: $(VENV)/installed-docs
	NO_MKDOCS_2_WARNING=1 $(BIN)/python -m mkdocs build --strict
	$(BIN)/python -m pytest tests/test_site.py
	@echo "The site is in site/: open site/index.html"

# Wheel and source archive, in dist/: checked, and the wheel installed into an environment of its own.
dist: $(VENV)/installed-dist
	rm -rf dist
	$(BIN)/python -m build --outdir dist .
	$(BIN)/python -m twine check --strict dist/*
	$(BIN)/python -m pytest tests/test_distribution.py
	$(PYTHON) -m venv --clear dist/.try
	dist/.try/bin/python -m pip install --quiet --constraint constraints.txt dist/*.whl
	cd dist && .try/bin/specmap --version && .try/bin/specmap info ../sample_logs/office.mcap
	rm -rf dist/.try

# All that a release needs, and at the end what was checked and what was not. Nothing is uploaded.
release: $(VENV)/installed-dist
	$(BIN)/python -m benchmarks.release check
	$(MAKE) test
	$(MAKE) docs
	$(MAKE) dist
	@$(BIN)/python -m benchmarks.release try && echo "  lint, tests, site (make docs), source archive: checked"

# The pictures of the documents, made of the sample logs.
pictures: $(VENV)/installed
	$(BIN)/python -m docs.pictures

sample-logs: $(VENV)/installed
	$(BIN)/python sample_logs/draw_office.py
	$(BIN)/specmap simulate sample_logs/office.yaml -o sample_logs/office.mcap --beams 181 --speed 0.8 --spacing 3 --laps 2 --seed 2 --overwrite
	$(BIN)/specmap simulate sample_logs/office.yaml -o sample_logs/office_again.mcap --beams 181 --speed 0.8 --spacing 3 --seed 7 --overwrite

# The pins of test-lowest, made anew when a floor in pyproject.toml has changed.
constraints-lowest: $(LOWEST)/created
	$(LOWEST)/bin/python -m pip install --quiet uv
	$(LOWEST)/bin/python -m uv pip compile --quiet --resolution lowest-direct --extra dev --extra batch --no-annotate \
		--python-version 3.11 --custom-compile-command "make $@" pyproject.toml --output-file constraints-lowest.txt

clean:
	rm -rf $(VENV) $(LOWEST) demo paper site dist .pytest_cache .mypy_cache .ruff_cache .hypothesis

$(VENV)/created:
	@if [ -z "$(PYTHON)" ]; then echo "make: no Python 3.11 or newer with the venv module found: install python3 and python3-venv, or say make PYTHON=/path/to/python3" >&2; exit 2; fi
	$(PYTHON) -m venv $(VENV)
	@touch $@

$(VENV)/installed: $(VENV)/created pyproject.toml constraints.txt
	$(BIN)/python -m pip install --quiet --constraint constraints.txt --editable .
	@touch $@

$(VENV)/installed-dev: $(VENV)/installed
	$(BIN)/python -m pip install --quiet --constraint constraints.txt --editable '.[dev,batch,consumers]'
	@touch $@

$(VENV)/installed-docs: $(VENV)/installed-dev
	$(BIN)/python -m pip install --quiet --constraint constraints.txt --editable '.[docs]'
	@touch $@

$(VENV)/installed-dist: $(VENV)/installed-dev
	$(BIN)/python -m pip install --quiet --constraint constraints.txt --editable '.[dist]'
	@touch $@

$(LOWEST)/created:
	@if ! $(PYTHON_LOWEST) -c 'import sys, ensurepip; sys.exit(sys.version_info[:2] != (3, 11))' 2>/dev/null; then echo "make: the lowest versions need Python 3.11 with the venv module: install it, or say make test-lowest PYTHON_LOWEST=/path/to/python3.11" >&2; exit 2; fi
	$(PYTHON_LOWEST) -m venv $(LOWEST)
	@touch $@

$(LOWEST)/installed-dev: $(LOWEST)/created pyproject.toml constraints-lowest.txt
	$(LOWEST)/bin/python -m pip install --quiet --constraint constraints-lowest.txt --editable '.[dev,batch]'
	@touch $@
