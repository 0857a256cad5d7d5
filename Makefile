# make demo | paper | app | bridge | test | test-browser | bench | cuda-report | gpu | accuracy | docs | gallery
#   | dist | lint | kernels | clean
# Everything is installed into .venv; a stamp per set of packages says that it is there.

PYTHON ?= python3
BIN := .venv/bin
# Python compiles what it imports by itself, and keeps it; most of what is installed never is.
export PYTHONDONTWRITEBYTECODE :=
INSTALL := $(BIN)/pip install --quiet --no-compile --disable-pip-version-check --constraint constraints.txt

# Importing the libraries of networks takes every process 15 s, so one process tests all that need them.
NETWORKS := $(shell grep -lE "^(from|import) (torch|safetensors.torch|reference.*formula|phy124.generators.neural)" tests/test_*.py)

.PHONY: demo paper app bridge test test-default test-networks test-page test-slow test-foreign test-browser bench cuda-report gpu accuracy docs gallery dist lint kernels clean chromium

demo: .venv/base
	$(BIN)/phy124 generate demo/examples/duck.png --scene press --stage studio --out out/duck-press

# The paper's control experiment as the paper has it: every Gaussian is a particle.
paper: .venv/base
	$(BIN)/phy124 generate demo/examples/sunflower.png --scene push_right --set binding=particles --out out/paper

app: .venv/demo
	$(BIN)/python app.py

bridge: .venv/bridge
	$(BIN)/python -m bridge doctor

# Side by side, since tests of the page wait more than they compute.
test:
	+$(MAKE) $(if $(findstring jobserver,$(MAKEFLAGS)),,--jobs 3 --output-sync=target) test-default test-networks test-page

# Three on two cores: tests of servers wait more than they compute. In order, since a file of one long
# test must not be the last.
test-default: .venv/bytecode
	$(BIN)/pytest -n 3 --dist loadfile --no-loadscope-reorder -m "not slow and not browser" $(NETWORKS:%=--ignore=%)

test-networks: .venv/test
	$(BIN)/pytest -m "not slow" $(NETWORKS)

test-page: .venv/test
	if command -v chromium-headless-shell || command -v chromium; then $(BIN)/pytest -m "browser and not slow" tests/e2e; fi

test-slow: .venv/test
	$(BIN)/pytest -m "slow and not gpu and not weights and not ros"

# Without their dependencies, since numba wants older packages than phy124.
test-foreign: .venv/test
	$(INSTALL) --no-deps gsply imagecodecs gaussforge numba llvmlite
	npm install --silent --prefix .venv/foreign @playcanvas/splat-transform
	PHY124_NODE_MODULES=.venv/foreign/node_modules $(BIN)/pytest -n 0 -m slow tests/test_formats_foreign.py

test-browser: chromium test-page

chromium:
	command -v chromium-headless-shell >/dev/null || (apt-get update -qq && apt-get install -y -qq chromium-headless-shell)

bench: .venv/test
	for script in tests/benchmarks/*.py; do $(BIN)/python $$script || exit 1; done

cuda-report: .venv/test
	$(BIN)/python tests/benchmarks/cuda_report.py --docs

gpu: .venv/test
	$(BIN)/python tests/benchmarks/gpu

accuracy: .venv/test
	$(BIN)/python tests/benchmarks/forecast.py --docs bounce drop press push_right spin sway
	$(BIN)/python tests/benchmarks/zoo.py --objects ../shared/objects --minutes 300
	$(BIN)/python tests/benchmarks/expectations.py
	$(BIN)/python tests/benchmarks/accuracy.py --docs
	$(BIN)/python tests/benchmarks/summaries.py

docs: .venv/docs
	$(BIN)/sphinx-build --quiet --fail-on-warning --keep-going --jobs 2 docs out/docs

gallery: .venv/base
	$(BIN)/python docs/images/gallery.py

dist: .venv/base
	$(INSTALL) build
	rm -rf dist
	$(BIN)/python -m build

lint: .venv/lint
	PATH="$(CURDIR)/$(BIN):$$PATH" $(BIN)/pre-commit run --all-files --show-diff-on-failure

kernels: .venv/base
	$(BIN)/phy124 warm

clean:
	rm -rf .venv out build dist *.egg-info .pytest_cache .ruff_cache .import_linter_cache .hypothesis

.venv/python: constraints.txt
	$(PYTHON) -m venv .venv
	touch $@

.venv/base: .venv/python pyproject.toml
	$(INSTALL) --editable .
	touch $@

.venv/demo: .venv/python pyproject.toml
	$(INSTALL) --editable ".[demo]"
	$(BIN)/phy124 warm
	touch $@ .venv/base

.venv/bridge: .venv/python pyproject.toml
	$(INSTALL) --editable ".[bridge,foxglove]"
	$(INSTALL) --editable ".[dds]" || echo "no cyclonedds for this machine: DDS needs ROS 2 here"
	touch $@ .venv/base

.venv/test: .venv/python pyproject.toml
	$(INSTALL) --editable ".[test]"
	touch $@ .venv/base .venv/demo .venv/bridge

# Imports everything once: otherwise each of the test processes, which start together, would compile it.
.venv/bytecode: .venv/test
	$(BIN)/pytest --collect-only --quiet --quiet $(NETWORKS:%=--ignore=%) > $@ || { cat $@; rm $@; exit 1; }

.venv/docs: .venv/python pyproject.toml
	$(INSTALL) --editable ".[docs]"
	touch $@ .venv/base

.venv/lint: .venv/python pyproject.toml
	$(INSTALL) --editable ".[test,lint,docs]"
	touch $@ .venv/base .venv/demo .venv/bridge .venv/test .venv/docs
