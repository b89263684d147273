# Everything sets itself up in .venv; the two commands to know are `make demo` and `make test`.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
PIP := $(BIN)/python -m pip install --quiet --disable-pip-version-check
# Two workers for tests: more cores may be given, as `make test JOBS=8`.
JOBS ?= 2
# Tests start BLAS, OpenCV and GDAL threads of their own only where stereomate says so.
export OMP_NUM_THREADS ?= 1
export OPENBLAS_NUM_THREADS ?= 1

.PHONY: demo test static test-real fast bounds bench lint types contract docs pictures lock clean

$(VENV)/.core: requirements/core.txt
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
	    { echo "$(PYTHON) is missing or older than 3.11; name another one: make PYTHON=python3.12 ..." >&2; exit 1; }
	@$(PYTHON) -c 'import venv, ensurepip' 2>/dev/null || \
	    { echo "$(PYTHON) cannot make virtual environments; on Debian and Ubuntu: apt-get install python3-venv" >&2; exit 1; }
	test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	$(PIP) --require-hashes -r requirements/core.txt
	touch $@

$(VENV)/.dev: $(VENV)/.core requirements/dev.txt
	$(PIP) --require-hashes -r requirements/dev.txt
	touch $@

# The build backend is locked too, so installing the package itself fetches nothing.
$(VENV)/.backend: $(VENV)/.core requirements/build.txt
	$(PIP) --require-hashes -r requirements/build.txt
	touch $@

$(VENV)/.installed: $(VENV)/.backend pyproject.toml
	$(PIP) --no-deps --no-build-isolation -e .
	touch $@

demo: $(VENV)/.installed
	$(BIN)/stereomate demo demo

test: static fast bounds

# What needs one core each, side by side.
static: $(VENV)/.installed $(VENV)/.dev
	@$(MAKE) --no-print-directory --output-sync=target -j $(JOBS) lint types contract docs

# Tests in a real browser take Debian's; where that cannot be installed they say so and fail.
$(VENV)/.browser: $(VENV)/.dev
	@command -v chromium >/dev/null || { apt-get update -qq && \
	    DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends chromium >/dev/null; } || \
	    echo "Chromium is missing and could not be installed (apt-get install chromium): tests in the browser will fail" >&2
	touch $@

fast: $(VENV)/.installed $(VENV)/.dev $(VENV)/.browser
	$(BIN)/python -m pytest -n $(JOBS) --dist worksteal -m "not real and not slow"

# Kernels once more, compiled with numba's bounds checks.
bounds: $(VENV)/.installed $(VENV)/.dev
	STEREOMATE_BOUNDSCHECK=1 $(BIN)/python -m pytest -n $(JOBS) --dist worksteal -q -m "not real and not slow" tests/kernels

test-real: $(VENV)/.installed $(VENV)/.dev $(VENV)/.browser
	$(BIN)/python -m pytest -n $(JOBS) --dist worksteal -m "real or slow"

lint: $(VENV)/.dev
	$(BIN)/ruff check src tests benchmarks docs
	$(BIN)/ruff format --check src tests benchmarks docs

types: $(VENV)/.dev $(VENV)/.installed
	$(BIN)/mypy

contract: $(VENV)/.dev $(VENV)/.installed
	$(BIN)/lint-imports

docs: $(VENV)/.dev $(VENV)/.installed
	$(BIN)/python -m sphinx -q -W --keep-going -b html docs docs/_build/html

# The pictures of the tutorial, from the demo.
pictures: demo
	$(BIN)/python docs/make_pictures.py demo

bench: $(VENV)/.installed $(VENV)/.dev
	$(BIN)/python -m benchmarks

# The locks carry hashes and no addresses of registries.
LOCK := $(VENV)/lock/bin/uv pip compile --universal --python-version 3.11 --generate-hashes --no-emit-index-url --no-header
lock: pyproject.toml
	test -x $(VENV)/lock/bin/uv || { $(PYTHON) -m venv $(VENV)/lock && \
	    $(VENV)/lock/bin/python -m pip install --quiet --disable-pip-version-check uv; }
	$(LOCK) pyproject.toml -o requirements/core.txt
	echo 'setuptools>=77' | $(LOCK) - -o requirements/build.txt
	$(LOCK) --extra dev --extra dask --extra las --extra opf --extra colmap --extra pdf -c requirements/core.txt pyproject.toml -o requirements/dev.txt

clean:
	rm -rf $(VENV) build dist demo docs/_build docs/_generated
