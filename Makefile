# make demo          renders render_jobs/demo.toml, verifies it, draws its contact sheet
# make train-demo    renders render_jobs/train_demo.toml, trains the preset tiny on it, draws a page
# make test          checks and tests everything
# make test-browser  tests the pages of `browse` and `demo` in a real browser, which it brings
# make test-wheel    builds the wheel, and reads, plans, browses and renders with nothing but it
# make lint          format, lint, types, import rules
# make docs          the documentation as a site, in out/site
# make setup         only .venv with what rendering takes
#
# Each sets up what it needs first. PYTHON names another interpreter (it must be 3.11: Blender's
# wheel is built for that one).

PYTHON ?= python3.11
OUT    ?= out/demo
DATA   ?= out/train_demo
RUN    ?= out/train_run
VENV   := .venv
BIN    := $(VENV)/bin
PIP    := $(BIN)/pip --disable-pip-version-check install --progress-bar off
# CPU builds of torch are a tenth of the size. Where this index cannot be reached, any build serves.
TORCH_CPU := --timeout 15 --retries 1 --extra-index-url https://download.pytorch.org/whl/cpu

# What lints and formats JavaScript and CSS.
BIOME  := 2.6.8

.PHONY: demo train-demo test test-browser test-wheel lint lint-js docs setup benchmark-setup clean
.DELETE_ON_ERROR:

setup: $(VENV)/.render

$(VENV)/bin/python:
	@command -v $(PYTHON) >/dev/null || { \
	  echo "$(PYTHON) not found: install Python 3.11, or say make PYTHON=/path/to/it"; exit 2; }
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info[:2] != (3, 11))' || { \
	  echo "$(PYTHON) is not Python 3.11, which Blender's wheel is built for"; exit 2; }
	@echo "== making $(VENV)"
	@$(PYTHON) -m venv $(VENV)

$(VENV)/.render: pyproject.toml | $(VENV)/bin/python
	@echo "== installing Blender and what rendering takes (about 400 MB, once)"
	@$(PIP) --editable '.[render]'
	@$(BIN)/python -c 'import bpy' 2>/dev/null || { \
	  echo "Blender's wheel needs system libraries that are missing here; on Debian and Ubuntu:"; \
	  echo "  apt-get install libx11-6 libxrender1 libxfixes3 libxi6 libxkbcommon0 libsm6 libgl1"; \
	  exit 2; }
	@touch $@

$(VENV)/.torch: | $(VENV)/bin/python
	@echo "== installing torch (about 200 MB, once)"
	@$(BIN)/python -c 'import torch' 2>/dev/null \
	  || $(PIP) $(TORCH_CPU) torch==2.13.0 || $(PIP) 'torch>=2.6,<2.14'
	@touch $@

$(VENV)/.train: $(VENV)/.render $(VENV)/.torch
	@echo "== installing what training takes (once)"
	@$(PIP) --editable '.[render,train]'
	@touch $@

$(VENV)/.dev: $(VENV)/.render $(VENV)/.torch
	@echo "== installing the tools that tests take (once)"
	@$(PIP) --editable '.[render,dev]'
	@touch $@

$(VENV)/.biome-$(BIOME):
	@echo "== installing biome (once)"
	@npm install --silent --no-audit --no-fund --prefix $(VENV)/js @biomejs/biome@$(BIOME)
	@touch $@

benchmark-setup: $(VENV)/.train
	@echo "== installing real face detectors"
	@# With the extras that are there already: mediapipe's protobuf asks for an older tensorboard.
	@$(PIP) --editable '.[train,benchmarks]'
	@$(PIP) --no-deps mediapipe==0.10.21

demo: setup
	@echo "== rendering render_jobs/demo.toml into $(OUT)"
	@$(BIN)/synthgen render render_jobs/demo.toml --out $(OUT)
	@echo "== verifying it"
	@$(BIN)/synthgen verify $(OUT)
	@echo "== drawing its contact sheet"
	@$(BIN)/synthgen sheet $(OUT) --output $(OUT).png

train-demo: $(VENV)/.train
	@echo "== rendering render_jobs/train_demo.toml into $(DATA) (interrupt it as you like: it resumes)"
	@# Exit code 1: a subject failed, which the others do without.
	@$(BIN)/synthgen render render_jobs/train_demo.toml --out $(DATA) || [ $$? -eq 1 ]
	@echo "== training the preset tiny in $(RUN) (so does this)"
	@$(BIN)/totalediting train all $(DATA) --out $(RUN) --preset tiny --precision auto
	@echo "== measuring it on people that it has not seen"
	@$(BIN)/totalediting evaluate $(RUN) $(DATA)
	@$(BIN)/totalediting show $(RUN) $(DATA) --output $(RUN).png

lint: $(VENV)/.dev lint-js
	@echo "== format and lint (ruff)"
	@$(BIN)/ruff format --check . && $(BIN)/ruff check .
	@echo "== types (pyright)"
	@$(BIN)/pyright
	@echo "== import rules (import-linter)"
	@$(BIN)/lint-imports

ifeq ($(shell command -v npm),)
lint-js:
	@echo "== no npm here: JavaScript and CSS are not linted"
else
lint-js: $(VENV)/.biome-$(BIOME)
	@echo "== JavaScript and CSS (biome)"
	@$(VENV)/js/node_modules/.bin/biome ci --error-on-warnings
endif

test: lint
	@echo "== tests (pytest)"
	@$(BIN)/pytest --numprocesses auto --maxprocesses 4 --dist loadfile

docs: $(VENV)/.dev
	@echo "== the documentation as a site, in out/site (mkdocs)"
	@$(BIN)/mkdocs build --strict --quiet

test-wheel: $(VENV)/.dev
	@echo "== the wheel in environments of its own"
	@$(BIN)/python tests/packaging/wheel.py

# Debian's Chromium brings the libraries that it needs; Playwright's own does for other systems. Where
# neither can be had, the tests are skipped and say so.
test-browser: $(VENV)/.dev
	@echo "== installing a browser and its driver (once)"
	@$(PIP) --editable '.[render,dev,browser,demo]' \
	  || echo "playwright or gradio cannot be installed here"
	@if command -v chromium >/dev/null; then :; \
	elif [ "$$(id -u)" = 0 ] && command -v apt-get >/dev/null \
	  && apt-get update -qq && apt-get install -y -qq --no-install-recommends chromium; then :; \
	elif $(BIN)/playwright install chromium; then :; \
	else echo "no Chromium can be installed here: the tests of the pages are skipped"; fi
	@echo "== tests in the browser (pytest)"
	@$(BIN)/pytest -m browser

clean:
	rm -rf out build *.egg-info .pytest_cache .ruff_cache .import_linter_cache
