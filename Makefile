# make demo: a recorded bag through the live localizer, a table and a picture.
# make test: lint, types, unit, property and integration tests, colcon build and colcon test.
# make faults: docs/faults.md, each fault through live nodes, about 20 minutes; not in make test.
# make scenarios: tests and issues of other localizers into docs/faults.md, about ten minutes.
# make hostile: a million hostile messages through the localizer, 10^5 through a node, half an hour.
# make soak: ten simulated days in one run, about an hour; not part of make test.
# make bench: docs/benchmarks.md, what everything costs, 15 to 20 minutes; not part of make test.
# make coverage: which lines of the package the tests run; make release-check: ready for a release?
# All set up .venv first, with pinned versions; nothing else is installed, but for make bench,
# which has filterpy and scipy in build/bench.

PYTHON ?= python3
VENV ?= .venv
BIN := $(VENV)/bin
COLCON := $(BIN)/colcon --log-base build/log
COLCON_PATHS := --build-base build/colcon --install-base build/install

# Nothing leaves this machine.
export ROS_AUTOMATIC_DISCOVERY_RANGE := LOCALHOST
export ROS_LOG_DIR := $(CURDIR)/build/ros_log

.PHONY: demo faults scenarios hostile test lint coverage release-check soak bench clean

demo: $(VENV)/.installed
	$(BIN)/python scripts/demo.py

faults: $(VENV)/.installed
	$(BIN)/python scripts/fault_matrix.py

scenarios: $(VENV)/.installed
	$(BIN)/python scripts/scenarios.py

test: $(VENV)/.installed-tests lint
	$(COLCON) build --paths . $(COLCON_PATHS)
	$(COLCON) test --paths . $(COLCON_PATHS) --return-code-on-test-failure \
	  --event-handlers console_direct+ --pytest-args --numprocesses auto --dist loadgroup
	$(COLCON) test-result --test-result-base build/colcon --verbose

# Another FNN_EKF_ROS_HOSTILE_SEED than 1 sends others.
hostile: export FNN_EKF_ROS_HOSTILE_SEED ?= 1
hostile: export FNN_EKF_ROS_HOSTILE_MESSAGES = 1000000
hostile: export FNN_EKF_ROS_HOSTILE_LIVE_MESSAGES = 100000
hostile: $(VENV)/.installed
	$(BIN)/python -m pytest -s test/localizer/test_hostile.py test/live/test_hostile_node.py

soak: $(VENV)/.installed
	$(BIN)/python scripts/soak.py

bench: $(VENV)/.installed
	$(BIN)/python scripts/benchmarks.py

lint: $(VENV)/.installed
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

# Of the tests without live nodes; nothing is written but the table on the terminal.
coverage: $(VENV)/.installed-tests
	mkdir -p build
	COVERAGE_FILE=build/coverage $(BIN)/python -m pytest -q -m "not live" -n auto --dist loadgroup \
	  --cov=fnn_ekf_ros --cov-branch --cov-report=term-missing:skip-covered

release-check: $(VENV)/.installed lint
	$(BIN)/python scripts/release_check.py

$(VENV)/.installed: requirements.txt requirements-ros.txt setup.py package.xml
	sh scripts/make_venv.sh "$(PYTHON)" "$(VENV)"
	touch $@

# For make coverage, the comparison with evo and the tests of /tf: make demo does not need them.
$(VENV)/.installed-tests: $(VENV)/.installed requirements-tests.txt
	$(BIN)/python -m pip install --disable-pip-version-check --quiet \
	  $$(grep -E '^[A-Za-z]' requirements-tests.txt | grep -v '^ros-')
	if ! $(BIN)/python -c 'import tf2_msgs' 2>/dev/null && command -v cmake >/dev/null; then \
	  $(BIN)/python -m pip install --disable-pip-version-check --quiet \
	    -r requirements-tests.txt; \
	fi
	touch $@

clean:
	rm -rf build demo $(VENV)
