# make demo   sets everything up, renders render_jobs/demo.toml, verifies it, prints its contact sheet
# make test   sets everything up, checks and tests everything
# make lint   format, lint, types, import rules
# make setup  only the set-up: .venv with everything in it
#
# PYTHON names another interpreter (it must be 3.11: Blender's wheel is built for that one).

PYTHON ?= python3.11
VENV   := .venv
BIN    := $(VENV)/bin
OUT    ?= out/demo
# CPU builds of torch are a tenth of the size; where this index cannot be reached, any build serves.
TORCH_CPU := https://download.pytorch.org/whl/cpu

.PHONY: demo test lint setup clean
.DELETE_ON_ERROR:

setup: $(VENV)/.installed

$(VENV)/bin/python:
	@command -v $(PYTHON) >/dev/null || { \
	  echo "make: $(PYTHON) not found: install Python 3.11, or make PYTHON=/path/to/it"; exit 2; }
	@echo "== making $(VENV) with $$($(PYTHON) --version)"
	@$(PYTHON) -m venv $(VENV)

$(VENV)/.torch: $(VENV)/bin/python
	@echo "== installing torch (a CPU build where one can be found)"
	@$(BIN)/python -c "import torch" 2>/dev/null \
	  || $(BIN)/pip install --quiet --disable-pip-version-check --progress-bar off \
	       --index-url $(TORCH_CPU) 'torch==2.13.0' 2>/dev/null \
	  || $(BIN)/pip install --disable-pip-version-check --progress-bar off 'torch==2.13.0' \
	  || $(BIN)/pip install --disable-pip-version-check --progress-bar off 'torch>=2.6,<2.14'
	@touch $@

$(VENV)/.installed: $(VENV)/.torch pyproject.toml
	@echo "== installing Blender, the head model and the tools (about 1 GB, once)"
	@$(BIN)/pip install --disable-pip-version-check --progress-bar off --quiet -e '.[render,dev]'
	@touch $@

demo: setup
	@echo "== rendering render_jobs/demo.toml into $(OUT)"
	@$(BIN)/synthgen render render_jobs/demo.toml --out $(OUT)
	@echo "== verifying $(OUT)"
	@$(BIN)/synthgen verify $(OUT)
	@$(BIN)/synthgen sheet $(OUT) --output $(OUT).png

lint: setup
	@echo "== format and lint (ruff)"
	@$(BIN)/ruff format --check --quiet . && $(BIN)/ruff check --quiet .
	@echo "== types (pyright)"
	@$(BIN)/pyright
	@echo "== import rules (import-linter)"
	@$(BIN)/lint-imports

test: lint
	@echo "== tests (pytest)"
	@$(BIN)/pytest

clean:
	rm -rf out build *.egg-info .pytest_cache .ruff_cache .import_linter_cache
