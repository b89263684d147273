# Everything sets itself up in .venv; the two commands to know are `make demo` and `make test`.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
# Tests start BLAS, OpenCV and GDAL threads of their own only where stereomate says so.
export OMP_NUM_THREADS ?= 1
export OPENBLAS_NUM_THREADS ?= 1

.PHONY: demo test test-real bench bench-relative lint types contract docs lock clean

$(VENV)/.core: requirements/core.txt
	test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --require-hashes -r requirements/core.txt
	touch $@

$(VENV)/.installed: $(VENV)/.core pyproject.toml
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-deps -e .
	touch $@

$(VENV)/.dev: $(VENV)/.core requirements/dev.txt
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --require-hashes -r requirements/dev.txt
	touch $@

demo: $(VENV)/.installed
	$(BIN)/stereomate demo demo

test: $(VENV)/.installed $(VENV)/.dev lint types contract docs
	$(BIN)/python -m pytest -n 2 --dist worksteal -m "not real and not slow"
	STEREOMATE_BOUNDSCHECK=1 $(BIN)/python -m pytest -n 2 --dist worksteal -q -m "not real and not slow and not wheel" tests/kernels

test-real: $(VENV)/.installed $(VENV)/.dev
	$(BIN)/python -m pytest -n 2 --dist worksteal -m "real or slow"

lint: $(VENV)/.dev
	$(BIN)/ruff check src tests benchmarks
	$(BIN)/ruff format --check src tests benchmarks

types: $(VENV)/.dev $(VENV)/.installed
	$(BIN)/mypy

contract: $(VENV)/.dev $(VENV)/.installed
	$(BIN)/lint-imports

docs: $(VENV)/.dev $(VENV)/.installed
	$(BIN)/python -m sphinx -q -W --keep-going -b html docs docs/_build/html

bench: $(VENV)/.installed $(VENV)/.dev
	$(BIN)/python -m benchmarks

# Needs uv; the locks carry hashes and no registry addresses.
lock:
	uv pip compile --universal --python-version 3.11 --generate-hashes --no-emit-index-url --no-header pyproject.toml -o requirements/core.txt
	uv pip compile --universal --python-version 3.11 --generate-hashes --no-emit-index-url --no-header --extra dev --extra dask --extra las --extra opf --extra colmap -c requirements/core.txt pyproject.toml -o requirements/dev.txt

clean:
	rm -rf $(VENV) build dist demo docs/_build
