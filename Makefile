# Set up and run Nightglass: needs Python 3.11+ and make, nothing else.
PYTHON ?= python3
VENV ?= .venv
BIN := $(VENV)/bin
PACKAGES := service pipeline catalog_tools nightglass.py
# The tests start hundreds of processes: modules are compiled once, whatever the caller's setting.
export PYTHONDONTWRITEBYTECODE :=
INSTALL = $(BIN)/python -m pip install --quiet --no-compile --require-hashes
# On all cores; some packages carry templates that are no Python.
COMPILE = $(BIN)/python -W ignore -m compileall -qq -j 0 $(VENV)/lib || true

.PHONY: demo test test-slow lint lock benchmarks pins clean

demo: $(VENV)/.runtime
	$(BIN)/nightglass demo -o demo --replace

# Types are checked beside the tests, as that takes one core for long.
test: $(VENV)/.tests
	$(BIN)/ruff check .
	$(BIN)/ruff format --check $(PACKAGES)
	$(BIN)/lint-imports
	$(BIN)/mypy & types=$$!; \
	$(BIN)/pytest -m "not slow" -n 2 --dist loadfile --no-loadscope-reorder; tests=$$?; \
	wait $$types && exit $$tests

test-slow: $(VENV)/.tests
	$(BIN)/pytest -m slow --hypothesis-profile search
	$(BIN)/pytest -m "hypothesis and not slow" --hypothesis-profile search

lint: $(VENV)/.tests
	$(BIN)/ruff check .
	$(BIN)/ruff format --check $(PACKAGES)
	$(BIN)/mypy
	$(BIN)/lint-imports

benchmarks: $(VENV)/.tests
	$(BIN)/python -m benchmarks.frame

# After what is drawn has changed on purpose; PINS="NAME ..." makes some of them (docs/pins.md).
pins: $(VENV)/.tests
	$(BIN)/python tests/pins/make.py $(PINS)
	NIGHTGLASS_PINS=anew $(BIN)/pytest -q tests/pins -k told

# The product's own dependencies, each pinned by hash.
$(VENV)/.runtime: requirements.lock pyproject.toml
	$(PYTHON) -c 'import sys; sys.exit("Nightglass needs Python 3.11 or newer; set PYTHON=/path/to/python3.11" if sys.version_info < (3, 11) else 0)'
	$(PYTHON) -m venv $(VENV)
	$(INSTALL) -r requirements.lock
	$(BIN)/python -m pip install --quiet --no-deps --no-build-isolation -e .
	$(COMPILE)
	touch $@

# The same and what the tests need.
$(VENV)/.tests: requirements-test.lock $(VENV)/.runtime
	$(INSTALL) -r requirements-test.lock
	$(COMPILE)
	touch $@

# Renew both lock files (needs `uv` on the path).
lock:
	uv pip compile -q --universal --python-version 3.11 --generate-hashes --no-emit-index-url --no-header --no-annotate --extra build --extra test pyproject.toml -o requirements-test.lock
	uv pip compile -q --universal --python-version 3.11 --generate-hashes --no-emit-index-url --no-header --no-annotate -c requirements-test.lock --extra build --extra mesh --extra postgresql --extra remote pyproject.toml -o requirements.lock

clean:
	rm -rf $(VENV) demo .pytest_cache .mypy_cache .ruff_cache .hypothesis
