# Three commands: `make demo` (the whole path on the built-in subject), `make test` and, with all slow tests, `make test-all`.
# Where you have an index with CPU-only torch (it saves 4 GB), name it: make demo TORCH_INDEX=https://...

PYTHON ?= $(shell for p in python3.12 python3.11 python3.13 python3; do command -v $$p >/dev/null 2>&1 && \
	$$p -c 'import sys; sys.exit(not sys.version_info >= (3, 11))' 2>/dev/null && { echo $$p; break; }; done)
VENV = .venv
RUN = $(VENV)/bin/python
TORCH_INDEX ?=
JOBS ?= 2  # test processes side by side
# bytecode is compiled once and kept: else each of hundreds of processes spends seconds on torch and SciPy alone
unexport PYTHONDONTWRITEBYTECODE

.PHONY: demo test test-all hard-cases hard-cases-night limits mutants setup system lint clean

demo: setup
	$(RUN) -m experiments.demo out/demo

PYTEST = OMP_WAIT_POLICY=PASSIVE OPENBLAS_NUM_THREADS=1 $(RUN) -m pytest -q -n $(JOBS) --dist worksteal --durations=40
# Where units are tested, a hook checks shapes and types at every call; whole paths run without, in half the time.
UNITS = files command avatar geometry capture train bake
UNHOOKED = --jaxtyping-packages=

# tests/README.md says which tests are slow, and what the runs share.
MADE := $(shell mktemp -u -d)
MAKE_ONCE = @mkdir -p $(MADE) && trap 'rm -rf $(MADE)' EXIT && export SELFSCAN_MADE=$(MADE) &&

test: setup
	$(VENV)/bin/ruff check .
	$(MAKE_ONCE) $(PYTEST) -m "not slow" $(UNITS:%=tests/%) && \
		$(PYTEST) -m "not slow" $(UNHOOKED) $(UNITS:%=--ignore=tests/%)

test-all: test lint
	$(PYTEST) -m slow $(UNHOOKED)

# Runs the hard cases and writes docs/hard-cases.md: case, bound, measured worst error, rasteriser.
hard-cases: setup
	$(RUN) -m pytest -q $(UNHOOKED) tests/hard_cases --hard-cases-report docs/hard-cases.md

# Writes docs/limits.md: the largest and smallest values for which what is promised holds, and what is said beyond.
limits: setup
	$(RUN) -m experiments.limits

# What hard cases hold by night: every reader fuzzed (an hour for 60 s each), all shaders rewritten, long commands under failing calls.
hard-cases-night: setup
	$(VENV)/bin/pip install --disable-pip-version-check -q 'atheris>=3'
	$(RUN) -m experiments.shader_rewrites --rounds 10
	$(RUN) -m experiments.nth_calls
	$(RUN) -m experiments.fuzz --page docs/fuzzing.md

# Errors planted one after the other, by hand and by chance: each must fail the tests named beside it.
mutants: setup
	$(RUN) -m experiments.mutants
	$(VENV)/bin/pip install --disable-pip-version-check -q cosmic-ray
	$(RUN) -m experiments.sampled_mutants -o docs/mutants.md

lint: setup
	$(VENV)/bin/ruff check .
	$(VENV)/bin/pyright --pythonpath $(RUN)

setup: $(VENV)/ready system

# uv fetches and unpacks side by side (pip, which takes its place where it fails, needs some three minutes); it knows pip's index
PIP_INDEX = $${PIP_INDEX_URL:-$$($(VENV)/bin/pip config get global.index-url 2>/dev/null || echo https://pypi.org/simple)}
WITH_UV = UV_DEFAULT_INDEX=$${UV_DEFAULT_INDEX:-$(PIP_INDEX)} $(VENV)/bin/uv pip install --python $(RUN)
WITH_PIP = $(VENV)/bin/pip install --disable-pip-version-check --no-compile

$(VENV)/ready: pyproject.toml
	@test -n "$(PYTHON)" || { echo "selfscan needs Python 3.11 or newer: apt install python3 python3-venv"; exit 1; }
	@echo "setting up $(VENV) once: about 7 GB (PyTorch brings CUDA; see README for less), half a minute behind a fast line"
	$(PYTHON) -m venv $(VENV)
	$(VENV)/bin/pip install --disable-pip-version-check -q uv || true
	$(if $(TORCH_INDEX),$(WITH_UV) --index-url $(TORCH_INDEX) torch || $(WITH_PIP) --index-url $(TORCH_INDEX) torch)
	$(WITH_UV) -e '.[bake,bench,dev]' || $(WITH_PIP) -e '.[bake,bench,dev]'
	touch $@

# EGL and a software rasteriser; OSMesa where the distribution still has it.
system:
	@sh .ci/system-packages.sh

clean:
	rm -rf out
