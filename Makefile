# Every target sets itself up: a virtual environment in .venv with the versions of locks/dev.txt,
# made anew when the lock or pyproject.toml changes.  The demo needs the plain package alone (PLAIN),
# the playground less, the other targets all that developers need (READY).  With an environment of your own:
# make test BIN=/path/to/bin READY=

PYTHON ?= $(shell for p in python3 python3.14 python3.13 python3.12 python3.11; do \
	$$p -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null && echo $$p && break; done)
BIN    ?= .venv/bin
READY  ?= .venv/.ready
PLAIN  ?= $(if $(READY),.venv/.plain)
JOBS   ?= auto
# pip takes the versions of the lock, also for the tool that builds the package; newer pips read the
# second variable for that.
PIP_INSTALL = PIP_CONSTRAINT=locks/dev.txt PIP_BUILD_CONSTRAINT=locks/dev.txt \
	$(1)/python workshop/show_installation.py \
	$(1)/python -m pip install --disable-pip-version-check --progress-bar off

# Tests start hundreds of commands; without bytecode files, each compiles the whole package again.
unexport PYTHONDONTWRITEBYTECODE

.DELETE_ON_ERROR:
.PHONY: help setup lock demo test test-slow test-all test-bare test-core test-matrix compiled lint types chaos fuzz mutants bench bench-long golden pictures dist docs docs-serve playground clean distclean

help:
	@echo "make demo      compile every example and drive it in simulation"
	@echo "make test      lint, types, layer rules and tests"
	@echo "make test-slow   more tests, which CI runs too; ROBOTS=car,lss chooses the robots"
	@echo "make test-all    every test, with every robot: the whole cross product"
	@echo "make test-bare   tests that use outside programs and libraries, without any of them"
	@echo "make test-core   the core in a copy without tools: lint, types and tests"
	@echo "make test-matrix  golden files with the oldest and newest Python and dependencies"
	@echo "make compiled  build the compiled wheel and use it (needs a C compiler)"
	@echo "make lock      write the newest versions that pyproject.toml allows to locks/"
	@echo "make chaos     random missions with faults: make chaos SEEDS=0:1000 JOBS=2 (docs/chaos.md)"
	@echo "make fuzz      broken and hostile files of every kind: make fuzz SEEDS=0:10000 JOBS=2"
	@echo "make mutants   do the tests notice small changes of the code? LAYER=can NUMBER=20 SEED=1"
	@echo "make bench     measure times and memory; writes bench.json"
	@echo "make bench-long  measure the accuracy and the growth to 1,000; writes bench-long.json"
	@echo "make golden    rewrite the tests' golden files and tables (review the diff)"
	@echo "make pictures  render the pictures of examples and modules"
	@echo "make dist      build and check the wheels and the source distribution"
	@echo "make docs      build the documentation as a site in build/site"
	@echo "make playground  build the playground in build/playground (needs npm) and show it"
	@echo "make docs-serve  show the site at http://127.0.0.1:8000, also while you edit it"
	@echo "make lint, make types, make clean, make distclean"

setup: $(READY)

# Makes an empty environment of the folder of the target.
define NEW_VENV
	@if [ -z "$(PYTHON)" ] || ! $(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null; then \
	  echo "error: Python 3.11 or newer is needed, and none was found as '$(or $(PYTHON),python3)'." >&2; \
	  echo "       Say where it is: make PYTHON=/path/to/python3.11" >&2; exit 1; fi
	@if ! $(PYTHON) -c 'import venv, ensurepip' 2>/dev/null; then \
	  echo "error: $(PYTHON) comes without venv or ensurepip." >&2; \
	  echo "       On Debian and Ubuntu: apt install python3-venv" >&2; exit 1; fi
	@echo "Setting up $(@D) (once, and when the versions change)" >&2
	@$(PYTHON) -m venv --clear $(@D)
endef

.venv/.plain: pyproject.toml locks/dev.txt
	$(NEW_VENV)
	@$(call PIP_INSTALL,.venv/bin) --no-compile --editable . $(NOT_INSTALLED)
	@touch $@

.venv/.ready: .venv/.plain
	@echo "Adding what developers need to .venv" >&2
	@$(call PIP_INSTALL,.venv/bin) --editable '.[dev]' $(NOT_INSTALLED)
	@touch $@

NOT_INSTALLED = || { echo "error: the packages could not be installed; see above." >&2; \
	echo "       If locks/dev.txt does not fit pyproject.toml: make lock" >&2; exit 1; }

# The environment of uv alone, so that a lock that does not fit can be written anew.
.venv-lock/bin/uv: locks/dev.txt
	@$(PYTHON) -m venv --clear .venv-lock
	@$(call PIP_INSTALL,.venv-lock/bin) uv
	@touch $@

# One version of each package for all Pythons, where there is one.  `make lock UPGRADE=` keeps the
# versions that pyproject.toml still allows.
UPGRADE ?= --upgrade
COMPILE = .venv-lock/bin/uv --no-config pip compile --quiet $(UPGRADE) --universal \
	--python-version 3.11 --fork-strategy fewest --custom-compile-command 'make lock'
lock: .venv-lock/bin/uv
	$(COMPILE) pyproject.toml --extra dev --extra bench --group tools --output-file locks/dev.txt
	$(COMPILE) --group dcfgen --output-file locks/dcfgen.txt
	$(COMPILE) --group drake --output-file locks/drake.txt
	$(COMPILE) --group dart --output-file locks/dart.txt
	$(COMPILE) --group pinocchio --output-file locks/pinocchio.txt
	$(COMPILE) --group usd --output-file locks/usd.txt
	$(COMPILE) --group usdcore --output-file locks/usdcore.txt
	$(COMPILE) --group warp --output-file locks/warp.txt
	$(COMPILE) --group jazzy --output-file locks/jazzy.txt
	$(COMPILE) --group kilted --output-file locks/kilted.txt

# The examples, and the original system's own configuration file where it lies beside the checkout.
ORIGINAL ?= $(wildcard ../*/data/thorvald_ii_standard.yaml)
IMPORTED = $(patsubst %.yaml,build/imported/%.yaml,$(notdir $(ORIGINAL)))
demo: $(PLAIN)
	@mkdir -p build/imported
	@$(foreach file,$(ORIGINAL),$(BIN)/python -m thorvaldc import $(file) \
	  -o build/imported/$(notdir $(file)) 2>/dev/null &&) true
	@$(BIN)/python -m thorvaldc demo $(sort $(wildcard examples/*/robot.yaml examples/*/fleet.yaml)) $(IMPORTED)

lint: $(READY)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	PYTHONPATH=. $(BIN)/lint-imports

types: $(READY)
	$(BIN)/mypy

# mypy runs beside the tests, and prints its errors at the end.
PYTEST = $(BIN)/python -m pytest --dist loadgroup
QUICK = -m "not slow and not exhaustive"
test: GROUP = $(QUICK)
test test-all: lint
	@mkdir -p build; $(BIN)/mypy >build/types.txt 2>&1 & types=$$!; \
	$(PYTEST) -n $(JOBS) $(GROUP) $(TESTS); tests=$$?; \
	wait $$types; types=$$?; cat build/types.txt; test $$tests = 0 && test $$types = 0

test-slow: $(READY)
	$(PYTEST) -n $(JOBS) -m "slow and not exhaustive" $(TESTS)

test-all: export ROBOTS = all

# Without outside programs and libraries (tests/outside_tools.py), those tests that used one with
# OUTSIDE=record, or TESTS.  Each passes or is skipped.
test-bare: $(READY)
	OUTSIDE=none $(PYTEST) -n $(JOBS) -m "not exhaustive" $(or $(TESTS),@build/outside-tests.txt)

# The core without its tools: a copy in which they are deleted, with the pages and figures about them.
CORE = build/core
test-core: $(READY)
	rm -rf $(CORE) && mkdir -p $(CORE)
	git ls-files -z -- . ':!thorvaldc/tools/*/*' ':!tests/tools' ':!tests/docs' ':!tests/playground' ':!playground' ':!tests/test_bench.py' \
	  ':!tests/fuzz/test_hostile_files.py' ':!examples/odometry_experiment/run.py' \
	  $(patsubst %,':!%',$(shell grep -l thorvaldc.tools bench/*.py)) | \
	  tar --null --files-from - --create | tar --extract --directory $(CORE)
	cd $(CORE) && export PYTHONPATH="$(abspath $(CORE))" PATH="$(abspath $(BIN)):$$PATH" && \
	  ruff check . && lint-imports && mypy thorvaldc && python -m pytest --dist loadgroup -n $(JOBS) $(QUICK) $(TESTS)

test-matrix: $(READY)
	@$(BIN)/python -c 'import uv' 2>/dev/null || $(call PIP_INSTALL,$(BIN)) uv
	JOBS=$(JOBS) $(BIN)/python workshop/test_matrix.py

# The compiled wheel, and in a copy with its binaries the tests of what compilation may change: the
# public API, classes of plug-ins and of Gymnasium, a control cycle.
COMPILED = build/compiled
COMPILED_TESTS = tests/test_api.py \
	tests/docs/test_snippets.py::test_the_snippets_of_a_page_run tests/docs/test_contributing.py \
	tests/tools/gym tests/odrive tests/vesc tests/jk_bms tests/conformance/test_calculators.py \
	tests/runtime/test_driver.py tests/runtime/calculators \
	$(patsubst %,tests/runtime/can_base/test_%.py,arming can_base cia402_driver plugins roboteq_driver) \
	tests/simulation/test_control_loop.py tests/simulation/test_scenario_run.py tests/simulation/test_episode.py \
	tests/simulation/physics/test_sim_base.py tests/simulation/physics/test_mujoco_base.py
compiled: $(READY)
	rm -rf $(COMPILED) && mkdir -p $(COMPILED)
	git ls-files -z | tar --null --files-from - --create | tar --extract --directory $(COMPILED)
	THORVALDC_COMPILE=1 $(BIN)/python -m build --no-isolation --wheel --outdir $(COMPILED)/dist .
	$(BIN)/python -m zipfile --extract $(COMPILED)/dist/*.whl $(COMPILED)
	cd $(COMPILED) && export PYTHONPATH="$(abspath $(COMPILED))" PATH="$(abspath $(BIN)):$$PATH" && \
	  python -m pytest --dist loadgroup -n $(JOBS) $(QUICK) tests/compiled_runtime.py $(or $(TESTS),$(COMPILED_TESTS))

SEEDS ?= 0:200
chaos: $(READY)
	$(BIN)/python -m tests.chaos --seeds $(SEEDS) --jobs $(JOBS:auto=1) $(CHAOS)

fuzz: $(READY)
	$(BIN)/python -m tests.fuzz --seeds $(SEEDS) --jobs $(JOBS:auto=1)

mutants: $(READY)
	$(BIN)/python workshop/mutants.py --number $(or $(NUMBER),10) --seed $(or $(SEED),1) \
	  --jobs $(JOBS:auto=1) $(addprefix --layer ,$(LAYER)) $(if $(ROBOTS),--last 'all robots')

# The library to compare with comes into the environment of the first bench, not of every test.
bench: $(READY)
	@$(BIN)/python -c 'import wpimath' 2>/dev/null || test -z "$(READY)" || \
	  $(call PIP_INSTALL,$(BIN)) --editable '.[bench]' || true
	$(BIN)/python -m bench

bench-long: $(READY)
	$(BIN)/python -m bench long

golden: $(READY)
	$(BIN)/python -m tests.golden.rewrite
	$(BIN)/python -m tests.tools.fault_matrix.fault_table_page
	$(BIN)/python -m tests.tools.fault_matrix.hazard_page
	$(BIN)/python -m tests.commissioning.fault_matrix
	$(BIN)/python -m tests.ros.parameter_table
	$(BIN)/python -m tests.docs.tutorial
	$(BIN)/python examples/odometry_experiment/run.py --write

pictures: $(READY)
	PYTHONPATH=. $(BIN)/python workshop/render_examples.py
	PYTHONPATH=. $(BIN)/python workshop/render_modules.py
	PYTHONPATH=. $(BIN)/python workshop/render_drives.py

# Wheels of the whole package and of the runtime alone for every computer, and the source
# distribution.  The release workflow builds compiled wheels beside them.
dist: $(READY)
	rm -rf dist
	THORVALDC_COMPILE=0 $(BIN)/python -m build --no-isolation --outdir dist .
	THORVALDC_COMPILE=0 $(BIN)/python -m build --no-isolation --wheel --outdir dist thorvaldc/runtime
	$(BIN)/python -m twine check --strict dist/*

# The variable silences the advertisement of another program.
docs: $(READY)
	NO_MKDOCS_2_WARNING=1 PYTHONPATH=. $(BIN)/python -m mkdocs build

# The playground is also a part of the site, where npm is installed.  Its build has an environment of
# its own with the packages that the compiler needs in a browser.
.venv-playground/.ready: locks/dev.txt
	$(NEW_VENV)
	@$(call PIP_INSTALL,$(@D)/bin) jinja2 jsonschema pyyaml xacro $(NOT_INSTALLED)
	@touch $@

playground: BIN := $(if $(READY),.venv-playground/bin,$(BIN))
playground: $(if $(READY),.venv-playground/.ready)
	PYTHONPATH=. $(BIN)/python playground/build.py build/playground
	@echo "http://127.0.0.1:8010/ (Ctrl-C ends the server; any static server shows build/playground)"
	@$(BIN)/python -m http.server --bind 127.0.0.1 --directory build/playground 8010

docs-serve: $(READY)
	NO_MKDOCS_2_WARNING=1 PYTHONPATH=. $(BIN)/python -m mkdocs serve

clean:
	rm -rf build dist bench.json bench-long.json .pytest_cache .mypy_cache .ruff_cache .import_linter_cache .hypothesis
	find . \( -path './.venv*' -o -path ./.matrix -o -path ./.mutants \) -prune -o -name __pycache__ -type d -print0 | xargs -0 rm -rf

distclean: clean
	rm -rf .venv .venv-lock .venv-playground .matrix .mutants
