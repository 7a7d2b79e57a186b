# Every target sets up what it needs: a fresh clone needs only Python 3.11+, its venv module and make.

PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.installed
BROWSER_STAMP := $(VENV)/.installed-browser
REFERENCE_STAMP := $(VENV)/.installed-reference
DOCS_STAMP := $(VENV)/.installed-docs
PYTEST_FLAGS ?= -n auto --dist loadgroup
# arguments of `make bench`
BENCH ?=
# Pythons for which `make wheel` compiles; PYTHON, if none is named
WHEEL_PYTHONS ?=
# processors that `make test-portable` computes as; all, if none is named
PROCESSORS ?=

# Debian's ROS 1, which is for Debian's own Python
DEBIAN_PYTHON ?= /usr/bin/python3
DEBIAN_PACKAGES ?= /usr/lib/python3/dist-packages
MINOR := import sys; print(sys.version_info[:2])
ROS_MODULES := rospy, sensor_msgs.msg, nav_msgs.msg, visualization_msgs.msg, tf2_msgs.msg, std_srvs.srv
ROS_PACKAGES := python3-rospy python3-roslaunch python3-rosbag python3-rostopic python3-rosservice \
	python3-sensor-msgs python3-nav-msgs python3-visualization-msgs python3-tf2-msgs python3-std-srvs

PIP_INSTALL := $(BIN)/python -m pip install --quiet --disable-pip-version-check

# pip's own settings (extra indexes, folders of wheels) must leave no trace in a lock file
PIP_TOOLS := pip-tools==7.6.2
CLEAN_PIP := env -u PIP_INDEX_URL -u PIP_EXTRA_INDEX_URL -u PIP_FIND_LINKS PIP_CONFIG_FILE=/dev/null
COMPILE := --quiet --generate-hashes --strip-extras --allow-unsafe --no-emit-options \
	--no-emit-index-url --no-emit-find-links --no-emit-trusted-host

.DEFAULT_GOAL := help
.PHONY: help install install-reference install-docs install-ros demo docs figures test \
	test-portable test-ros test-browser check bench wheel test-wheel test-bounds lock clean

help: ## show this list
	@awk -F ':.*## ' '/^[a-z-]+:.*## / { printf "make %-18s %s\n", $$1, $$2 }' $(MAKEFILE_LIST)

install: $(STAMP) ## make .venv and install the locked dependencies and ovmot into it

$(STAMP): requirements.lock pyproject.toml
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null || { \
		echo "ovmot needs Python 3.11 or newer as '$(PYTHON)': sudo apt-get install python3.11 python3.11-venv, then make PYTHON=python3.11" >&2; exit 1; }
	@$(BIN)/python -m pip --version >/dev/null 2>&1 || $(PYTHON) -m venv $(VENV) >/dev/null 2>&1 || { \
		rm -rf $(VENV); echo "$(PYTHON) cannot make a virtual environment: sudo apt-get install python3-venv (or, for another Python than the system's, pythonX.Y-venv)" >&2; exit 1; }
	@echo "installing ovmot into $(VENV)"
	@$(PIP_INSTALL) --require-hashes -r requirements.lock
	@$(PIP_INSTALL) --no-build-isolation --no-deps -e .
	@echo "compiling what the first run would compile"
	@$(BIN)/ovmot warmup
	@touch $@

install-reference: $(REFERENCE_STAMP) ## add evo and TrackEval, with which some tests compare

$(REFERENCE_STAMP): $(STAMP) requirements-reference.lock requirements-trackeval.lock
	@echo "installing evo and TrackEval into $(VENV)"
	@$(PIP_INSTALL) --require-hashes -r requirements-reference.lock
	@$(PIP_INSTALL) --require-hashes --no-deps -r requirements-trackeval.lock
	@touch $@

install-docs: $(DOCS_STAMP) ## add what the site and the notebook are made with, and their tests need

$(DOCS_STAMP): $(STAMP) requirements-docs.lock
	@echo "installing MkDocs and Jupyter's kernel into $(VENV)"
	@$(PIP_INSTALL) --require-hashes -r requirements-docs.lock
	@touch $@

$(BROWSER_STAMP): $(STAMP) requirements-browser.lock
	@echo "installing Playwright and Rerun's SDK into $(VENV)"
	@$(PIP_INSTALL) --require-hashes -r requirements-browser.lock
	@touch $@

install-ros: $(STAMP) ## let .venv see Debian's packages of ROS 1, behind its own
	@test "$$($(BIN)/python -c '$(MINOR)')" = "$$($(DEBIAN_PYTHON) -c '$(MINOR)')" || { \
		echo "ROS 1 is for Debian's own Python, and .venv has another: make clean, then make install-ros PYTHON=$(DEBIAN_PYTHON)" >&2; exit 1; }
	@$(BIN)/python -m ovmot.ros.environment --link $(DEBIAN_PACKAGES) 2>/dev/null || true
	@{ $(BIN)/python -c 'import $(ROS_MODULES)' && command -v roscore rosbag rostopic rosservice; } >/dev/null 2>&1 || { \
		echo "ROS 1 is not all there: sudo apt-get install $(ROS_PACKAGES)" >&2; exit 1; }

demo: install ## simulate a small street, run ovmot on it, say where the results are
	$(BIN)/ovmot demo runs/demo

docs: install-docs ## build the site into build/site, offline; a warning is an error
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict
	@echo "build/site/index.html"

figures: install ## make the docs' figures anew: simulates and runs, some minutes
	$(BIN)/python docs/figures/all.py

test: install ## run the tests
	$(BIN)/python -m pytest $(PYTEST_FLAGS)

test-portable: install ## run the numerical tests as other processors compute (PROCESSORS=Haswell: one)
	$(BIN)/python tests/other_processors.py --processors "$(PROCESSORS)" $(PYTEST_FLAGS)

test-ros: install-ros ## test the live node with a real ROS 1 master (docs/ros.md)
	OVMOT_TEST_ROS=1 $(BIN)/python -m pytest -n 0 -s tests/ros/test_ros1_node.py

test-browser: $(BROWSER_STAMP) ## test the report in Chromium, and recordings for Rerun by its SDK
	@command -v chromium >/dev/null || command -v chromium-browser >/dev/null || { \
		echo "the report is tested in Chromium: sudo apt-get install chromium" >&2; exit 1; }
	$(BIN)/python -m pytest -n 0 -m "browser or rerun"

check: install ## lint, format, types, layers
	$(BIN)/ruff check
	$(BIN)/ruff format --check
	$(BIN)/mypy
	$(BIN)/lint-imports --no-logo

bench: install ## measure speed beside the floor of OpenCV alone (BENCH="--runs 3 FOLDER": see docs/performance.md)
	$(BIN)/python benchmarks/bench.py $(BENCH)

wheel: ## build dist/ovmot-*.whl with its compiled code, and the source package (WHEEL_PYTHONS="python3.12 python3.13": code for these)
	$(PYTHON) .ci/build_wheel.py $(WHEEL_PYTHONS)

test-wheel: wheel ## try the wheel in an empty environment and folder (PYTHON=python3.13: with another one)
	$(PYTHON) .ci/try_wheel.py dist/*.whl

test-bounds: wheel ## the same with the newest and with the lowest dependencies that pyproject.toml allows
	$(PYTHON) .ci/try_wheel.py dist/*.whl
	$(PYTHON) .ci/try_wheel.py dist/*.whl --lowest

lock: ## bring the lock files in line with pyproject.toml (UPGRADE=--upgrade: newest versions)
	@tools=$$(mktemp -d) && trap 'rm -rf "$$tools"' EXIT && \
	$(PYTHON) -m venv "$$tools" && \
	$(CLEAN_PIP) "$$tools/bin/pip" install --quiet --disable-pip-version-check $(PIP_TOOLS) && \
	export CUSTOM_COMPILE_COMMAND='make lock' && \
	$(CLEAN_PIP) "$$tools/bin/pip-compile" $(COMPILE) $(UPGRADE) \
		--extra dev -o requirements.lock pyproject.toml && \
	$(CLEAN_PIP) "$$tools/bin/pip-compile" $(COMPILE) $(UPGRADE) -c requirements.lock \
		--extra reference -o requirements-reference.lock pyproject.toml && \
	$(CLEAN_PIP) "$$tools/bin/pip-compile" $(COMPILE) $(UPGRADE) -c requirements.lock \
		--extra docs -o requirements-docs.lock pyproject.toml && \
	$(CLEAN_PIP) "$$tools/bin/pip-compile" $(COMPILE) $(UPGRADE) -c requirements.lock \
		--extra browser --extra rerun -o requirements-browser.lock pyproject.toml

clean: ## remove the virtual environment and every cache
	rm -rf $(VENV) build dist .pytest_cache .mypy_cache .ruff_cache .import_linter_cache
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
