# Every target sets itself up: it needs only python3 (3.10 to 3.14), python3-venv and make.
# PYTHON=/path/to/python3 chooses the interpreter that the environments are made with.

PYTHON ?= python3
VENV := .venv
JAZZY := .venv-jazzy
ROS := .venv-ros
COLCON := .venv-colcon
EVO := .venv-evo
CONFORMANCE := .venv-conformance
EIGEN := /usr/include/eigen3
ORACLES := .venv-oracles
LOCK := .venv-lock
ATHERIS := .venv-fuzz
MUTATE := .venv-mutate
AUDIT := .venv-audit
SITE := .venv-site
BENCH ?=
FUZZ ?=
KERNELS ?=
ROS_TEST_DOMAIN ?= 71

# Where there are no wheels of ROS 2, the demo is about a recording alone.
HAS_ROS_WHEELS := import platform, sys; sys.exit((sys.platform, platform.machine()) != \
	("linux", "x86_64") or sys.version_info > (3, 13))
DEMO := $(if $(shell $(PYTHON) -c '$(HAS_ROS_WHEELS)' && echo yes),$(ROS),$(VENV))
# Discovery must not leave this machine, and a robot's own domain must not hear of us.
ALONE := ROS_HOME=$$(mktemp -d) && export ROS_HOME && trap 'rm -rf "$$ROS_HOME"' EXIT && \
	ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST ROS_DOMAIN_ID=$(ROS_TEST_DOMAIN)

# Containers often forbid bytecode. Then every process compiles the package again, and every worker
# of the tests rewrites all of them, which takes a third of the time of `make test`.
export PYTHONDONTWRITEBYTECODE :=
# pip would compile modules that nothing imports, which takes two thirds of an environment's time.
export PIP_COMPILE := 0

.DEFAULT_GOAL := help
.DELETE_ON_ERROR:
.PHONY: help install demo demo-real test test-slow test-jazzy test-ros test-real lint format bench bench-gnss \
	bench-live bench-runs bench-scale bench-diagnosis bench-watch soak parity conformance fuzz fuzz-bytes chaos \
	chaos-ros mutate audit lock colcon-environment ros-environment clean settings site serve-site test-kernels \
	test-all test-stress oracles beside-ros

help: ## List the targets.
	@grep -hE '^[a-z-]+:.*##' $(MAKEFILE_LIST) | sed -E 's/:[^#]*## /\t/' | expand -t 14

install: $(VENV)/.installed ## Make the environment in .venv; .venv/bin/trajeval is the command.

demo: ## Evaluate a simulated flight live and recorded, draw it in Rerun; see demo_output/.
	@$(MAKE) --no-print-directory $(DEMO)/.installed
	$(ALONE) $(DEMO)/bin/trajeval demo demo_output

SECONDS ?= 60
ESTIMATORS ?= small_gicp kiss_icp

demo-real: $(DEMO)/.estimators ## Evaluate real lidar odometry live and recorded; SECONDS=60 REAL_TIME=1.
	$(ALONE) OPENBLAS_NUM_THREADS=1 $(DEMO)/bin/python -m examples.lidar_odometry.demo demo_real_output \
		--seconds $(SECONDS) $(if $(REAL_TIME),--real-time) --estimators $(ESTIMATORS)

# Each process has one thread of linear algebra: more of them than cores wait for each other.
test test-slow test-jazzy: export OPENBLAS_NUM_THREADS := 1

# A worker begins with neighbours, which share what a module has prepared, and ends with whatever
# the others have left.
PYTEST_ALL_CORES := python -m pytest -n auto --dist worksteal
FAST := -m "not slow and not ros and not oracles"
# Tests over DDS mostly wait, so two run at a time, in domains of their own; those of a file share
# nodes. What runs beside them yields: NICE="nice -n 19".
NICE ?=

test: $(VENV)/.installed ## Run the tests that take minutes; browsers, viewers, clusters and ROS are left out.
	$(VENV)/bin/$(PYTEST_ALL_CORES) $(FAST)

test-real: $(DEMO)/.estimators ## Run the tests of real estimators, beside `make demo-real`.
	$(ALONE) $(DEMO)/bin/python -m pytest -m ros -k small_gicp \
		tests/ros/test_lidar_odometry.py

# Some wait for viewers and browsers, so there is one process more than cores.
test-slow: export PYTEST_XDIST_AUTO_NUM_WORKERS ?= $(shell expr $$(nproc) + 1)
test-slow: $(VENV)/.installed ## Run the tests that take long, or start browsers, viewers and clusters.
	$(NICE) $(VENV)/bin/$(PYTEST_ALL_CORES) -m "slow and not ros and not oracles"

test-all: test test-slow ## Run all tests: fast ones, slow ones, and those that need ROS 2.
	$(if $(filter $(ROS),$(DEMO)),@$(MAKE) --no-print-directory beside-ros,\
		@echo "there are no wheels of ROS 2 for this machine: its tests are left out")

BESIDE ?= oracles

beside-ros: $(ROS)/.installed $(ROS)/.tf2_msgs
	@$(MAKE) --no-print-directory --jobs 2 --output-sync=target NICE="nice -n 19" test-ros $(BESIDE)

# As on an old CPU: a failure of `make test-jazzy` alone is of the versions or of its arithmetic.
test-jazzy: $(JAZZY)/.installed ## Run the tests of `make test` on ROS 2 Jazzy's versions, with Nehalem's arithmetic.
	$(NICE) env $$($(JAZZY)/bin/python tests/support/kernels.py --environment Nehalem) \
		$(JAZZY)/bin/$(PYTEST_ALL_CORES) $(FAST)

test-kernels: $(VENV)/.installed ## Run the fast numeric tests with the arithmetic of other CPUs; KERNELS="Nehalem".
	$(NICE) $(VENV)/bin/python tests/support/kernels.py $(KERNELS)

test-ros: $(ROS)/.installed $(ROS)/.tf2_msgs ## Run the tests that need ROS 2, between processes over DDS.
	$(ALONE) $(ROS)/bin/python -m pytest -n 2 --dist loadfile -m ros

oracles: $(ORACLES)/.installed ## Compare the estimator with Ceres and GTSAM, in an environment of their own.
	OPENBLAS_NUM_THREADS=1 $(NICE) $(ORACLES)/bin/python -m pytest -m oracles tests/papers/test_solver_oracles.py

TARGET ?= test
TIMES ?= 3
BUSY ?= 8

test-stress: $(VENV)/.installed ## Run `make test` three times beside eight busy processes; TARGET=test-all.
	bash .ci/stress $(TIMES) $(BUSY) $(MAKE) --no-print-directory $(TARGET)

lint: $(VENV)/.installed ## Check style, format and types.
	$(VENV)/bin/ruff check
	$(VENV)/bin/ruff format --check
	$(VENV)/bin/mypy

format: $(VENV)/.installed ## Correct style and format where a tool can, and wrap the lines of pages.
	$(VENV)/bin/ruff check --fix
	$(VENV)/bin/ruff format
	$(VENV)/bin/python tests/support/prose.py $$(git ls-files '*.md')

bench: $(VENV)/.installed $(EVO)/.installed $(ORACLES)/.installed ## Compare with evo, readers of bags and GTSAM, time the rest; BENCH="--only bags".
	$(VENV)/bin/python -m benchmarks.run --evo $(EVO)/bin/evo_ape \
		--oracles $(ORACLES)/bin/python $(BENCH)

parity: $(VENV)/.installed $(EVO)/.installed ## Compare with evo, number by number, on pairs from a new seed; SEED=1.
	$(VENV)/bin/python -m benchmarks.parity --evo $(EVO)/bin/evo_ape $(if $(SEED),--seed $(SEED))

# The exit status of score.py is 1, because numbers of some tools differ from the kit's definitions.
conformance: $(VENV)/.installed $(CONFORMANCE)/.installed ## Score evo, KISS-ICP, PyPose, Eigen and trajeval on the cases in conformance/.
	mkdir -p conformance/results
	$(CONFORMANCE)/bin/python conformance/independent.py > conformance/results/independent.json
	python3 conformance/score.py --relative 1e-12 conformance/results/independent.json
	$(VENV)/bin/python conformance/adapters/run_trajeval.py > conformance/results/trajeval.json
	for tool in evo kiss_icp pypose rpg; do \
		$(CONFORMANCE)/bin/python conformance/adapters/run_$$tool.py > conformance/results/$$tool.json || exit; \
	done
	if test -d $(EIGEN); then \
		g++ -O2 -I $(EIGEN) conformance/examples/umeyama.cpp -o conformance/results/umeyama && \
		conformance/results/umeyama conformance/cases/*/ > conformance/results/eigen.json; \
	else echo "Eigen is left out: apt install libeigen3-dev"; fi
	-python3 conformance/score.py --table conformance/results/*.json

bench-runs: $(VENV)/.installed ## Time comparisons of a thousand runs; BENCH="--runs 200".
	$(VENV)/bin/python -m benchmarks.many_runs $(BENCH)

bench-scale: $(VENV)/.installed ## Measure what tens of thousands of runs cost beside their evaluation; BENCH="--runs 400,2000".
	$(VENV)/bin/python -m benchmarks.scale $(BENCH)

bench-gnss: $(VENV)/.installed ## Measure how often intervals by GNSS fixes hold; BENCH="--draws 3".
	$(VENV)/bin/python -m benchmarks.gnss $(BENCH)

bench-diagnosis: $(VENV)/.installed ## Print which mistakes a diagnosis names, and its false alarms; BENCH="--only cpu".
	OPENBLAS_NUM_THREADS=1 $(VENV)/bin/python -m benchmarks.diagnosis $(BENCH)

bench-watch: $(VENV)/.installed ## Measure what `trajeval watch` finds on the recordings in DATA.
	$(VENV)/bin/python -m benchmarks.watch $(or $(DATA),$(error DATA=FOLDER with euroc, bags and gnss)) \
		$(BENCH)

bench-live: $(ROS)/.installed ## Measure the live node over DDS on loopback.
	$(ROS)/bin/python -m benchmarks.live_node $(BENCH)

HOURS ?= 2

soak: $(ROS)/.installed ## Measure the live node's memory and losses over two hours of data, at 20 times their speed.
	$(ROS)/bin/python -m benchmarks.live_node --soak $(HOURS) $(BENCH)

# The figures of the gallery are drawn anew, which takes a minute. A warning is an error.
site: $(SITE)/.installed ## Build the documentation in site/; nothing in it needs a network.
	NO_MKDOCS_2_WARNING=1 OPENBLAS_NUM_THREADS=1 $(SITE)/bin/mkdocs build --quiet

settings: $(VENV)/.installed ## Write docs/settings.md and config/evaluator.yaml from the table of settings.
	$(VENV)/bin/python docs/site/settings_tables.py

serve-site: site ## Build the documentation and serve it on http://127.0.0.1:8000.
	$(SITE)/bin/python -m http.server --bind 127.0.0.1 --directory site 8000

FUZZ_S ?= 300

fuzz: $(VENV)/.installed ## Read 10 000 changed inputs of all formats; FUZZ="--seed 1 --count 800".
	OPENBLAS_NUM_THREADS=1 $(VENV)/bin/python tests/support/fuzz_structures.py $(FUZZ)
	OPENBLAS_NUM_THREADS=1 $(VENV)/bin/python tests/support/fuzz_structures.py --format hostile --count 2000

CHAOS ?= --seed 1 --kills 200

chaos: $(VENV)/.installed ## Kill all verbs that write at random moments; CHAOS="--seed 1 --kills 20".
	OPENBLAS_NUM_THREADS=1 $(VENV)/bin/python tests/support/chaos.py $(CHAOS) evaluate compare finish simulate
	$(if $(filter $(ROS),$(DEMO)),@$(MAKE) --no-print-directory chaos-ros,\
		@echo "there are no wheels of ROS 2 for this machine: the replay and the node are left out")

chaos-ros: $(ROS)/.installed ## Kill the replay and the live node at random moments.
	$(ALONE) $(ROS)/bin/python tests/support/chaos.py $(CHAOS) replay node

fuzz-bytes: $(ATHERIS)/.installed ## Feed the readers of bags with damaged bytes for five minutes.
	mkdir -p $(ATHERIS)/corpus
	$(ATHERIS)/bin/python tests/support/fuzz_bags.py $(ATHERIS)/corpus -max_total_time=$(FUZZ_S) \
		-max_len=8192 -artifact_prefix=$(ATHERIS)/

SUBPACKAGE ?= metrics

mutate: $(MUTATE)/.installed ## Change lines of a subpackage at random, and list what no test notices; SUBPACKAGE=all.
	OPENBLAS_NUM_THREADS=1 $(MUTATE)/bin/python tests/support/mutants.py $(SUBPACKAGE)

audit: $(AUDIT)/.installed ## Look locked packages up in PyPI's database of known vulnerabilities.
	@status=0; for constraints in constraints.txt constraints-ros.txt; do \
		echo "$$constraints:"; \
		$(AUDIT)/bin/pip-audit --strict --no-deps --disable-pip --requirement $$constraints || status=1; \
	done; exit $$status

COMPILE = $(LOCK)/bin/uv pip compile --universal --python-version 3.10 --upgrade --quiet \
	--no-header --no-annotate --no-emit-index-url

lock: $(LOCK)/.installed ## Renew the constraints and the requirements of a release.
	$(COMPILE) --extra dev \
		--output-file constraints.txt pyproject.toml .ci/colcon-requirements.txt \
		.ci/site-requirements.txt
	$(COMPILE) --extra ros --extra plot --extra test --constraint constraints-jazzy.txt \
		--output-file constraints-ros.txt pyproject.toml .ci/rerun-requirements.txt
	printf 'build\nsetuptools==79.0.1\ntwine\n' | $(LOCK)/bin/uv pip compile --python-platform linux \
		--python-version 3.11 --generate-hashes --upgrade --quiet --no-header --no-annotate \
		--no-emit-index-url --output-file .ci/release-requirements.txt -
	rm -rf trajeval_ros.egg-info

colcon-environment: $(COLCON)/.installed

ros-environment: $(ROS)/.installed $(ROS)/.tf2_msgs ## Make .venv-ros, with ROS 2 Jazzy's wheels.

clean: ## Remove the environments and all that runs leave behind.
	rm -rf $(VENV) $(JAZZY) $(ROS) $(COLCON) $(EVO) $(CONFORMANCE) $(ORACLES) $(LOCK) $(ATHERIS) $(MUTATE) \
		$(AUDIT) $(SITE) site build install log dist *.egg-info \
		demo_output demo_real_output conformance/results benchmarks/data benchmarks/results.json \
		.pytest_cache .mypy_cache .ruff_cache .hypothesis
	find . -name __pycache__ -type d -prune -exec rm -rf {} +

# An environment is made anew when what it is made from has changed. A ROS workspace that
# holds this checkout must not look for packages in it, hence COLCON_IGNORE.
define make_venv
@$(PYTHON) -c 'import sys; sys.exit(not (3, 10) <= sys.version_info[:2] < (3, 15))' || \
	{ echo "$(PYTHON) is not Python 3.10 to 3.14; choose one: make PYTHON=..." >&2; exit 2; }
@$(PYTHON) -c 'import ensurepip, venv' 2>/dev/null || \
	{ echo "$(PYTHON) can't make environments; install it: apt-get install python3-venv" >&2; exit 2; }
$(PYTHON) -m venv --clear $(@D)
touch $(@D)/COLCON_IGNORE
endef

PIP_INSTALL = $(@D)/bin/python -m pip install --quiet

$(VENV)/.installed: pyproject.toml setup.py constraints.txt
	$(make_venv)
	$(PIP_INSTALL) --constraint constraints.txt --editable ".[dev]"
	touch $@

$(JAZZY)/.installed: pyproject.toml setup.py constraints-jazzy.txt
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info[:2] > (3, 12))' || \
		{ echo "numpy 1.26.4 has wheels up to Python 3.12; choose one: make PYTHON=..." >&2; exit 2; }
	$(make_venv)
	$(PIP_INSTALL) --constraint constraints-jazzy.txt --editable ".[test]"
	touch $@

$(ROS)/.installed: pyproject.toml setup.py constraints-ros.txt constraints.txt .ci/rerun-requirements.txt
	$(make_venv)
	$(PIP_INSTALL) --constraint constraints-ros.txt \
		--requirement .ci/rerun-requirements.txt --editable ".[ros,plot,test]"
	$(PIP_INSTALL) --constraint constraints.txt --no-deps rerun-sdk
	touch $@

# Estimators without wheels are left out; the demo names them.
$(DEMO)/.estimators: $(DEMO)/.installed .ci/demo-real-requirements.txt
	grep -v '^#' .ci/demo-real-requirements.txt | while read -r requirement; do \
		$(PIP_INSTALL) --only-binary :all: "$$requirement" || true; \
	done
	touch $@

# Without a compiler there is none; then it says so, and the tests of /tf are skipped.
$(ROS)/.tf2_msgs: $(ROS)/.installed .ci/make_tf2_msgs .ci/tf2_msgs-requirements.txt \
		$(wildcard tests/tf2_msgs/* tests/tf2_msgs/msg/* \
		tests/rosbag2_interfaces/* tests/rosbag2_interfaces/srv/* tests/px4_msgs/* tests/px4_msgs/msg/*)
	bash .ci/make_tf2_msgs $(ROS)

$(COLCON)/.installed: pyproject.toml setup.py constraints.txt .ci/colcon-requirements.txt
	$(make_venv)
	$(PIP_INSTALL) --constraint constraints.txt \
		--requirement .ci/colcon-requirements.txt --editable .
	$(COLCON)/bin/python -m pip uninstall --quiet --yes trajeval-ros  # colcon builds it
	touch $@

$(EVO)/.installed: benchmarks/requirements.txt constraints.txt
	$(make_venv)
	$(PIP_INSTALL) --constraint constraints.txt --requirement benchmarks/requirements.txt
	touch $@

# PyPose needs torch, so this environment has 1.4 GB.
$(CONFORMANCE)/.installed: conformance/requirements.txt
	$(make_venv)
	$(PIP_INSTALL) --requirement conformance/requirements.txt
	touch $@

# atheris has wheels for Python 3.11 to 3.13 on Linux.
$(ATHERIS)/.installed: pyproject.toml setup.py constraints.txt
	$(make_venv)
	$(PIP_INSTALL) --constraint constraints.txt --editable . atheris==3.0.0
	touch $@

$(MUTATE)/.installed: pyproject.toml setup.py constraints.txt
	$(make_venv)
	$(PIP_INSTALL) --constraint constraints.txt --editable ".[dev]" cosmic-ray==8.7.0
	touch $@

$(AUDIT)/.installed:
	$(make_venv)
	$(PIP_INSTALL) pip-audit==2.10.1
	touch $@

$(SITE)/.installed: pyproject.toml setup.py constraints.txt .ci/site-requirements.txt
	$(make_venv)
	$(PIP_INSTALL) --constraint constraints.txt \
		--requirement .ci/site-requirements.txt --editable ".[compare]"
	touch $@

# Wheels for Linux and macOS.
$(ORACLES)/.installed: pyproject.toml setup.py constraints.txt .ci/oracles-requirements.txt
	$(make_venv)
	$(PIP_INSTALL) --constraint constraints.txt \
		--requirement .ci/oracles-requirements.txt --editable ".[test]"
	touch $@

$(LOCK)/.installed:
	$(make_venv)
	$(PIP_INSTALL) uv
	touch $@
