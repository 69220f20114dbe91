# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0

PYTHON ?= python3
VENV := .venv

# Where ROS 2 Jazzy is sourced it is used; elsewhere it comes from PyPI.
ifeq ($(shell [ "$$ROS_DISTRO" = jazzy ] && $(PYTHON) -c 'import rclpy' 2>/dev/null && echo sourced),sourced)
ROS := sourced
VENV_OPTIONS := --system-site-packages
DEMO_EXTRAS := plot
TEST_EXTRAS := plot,dask,foxglove,test
else
ROS := pypi
VENV_OPTIONS :=
DEMO_EXTRAS := plot,jazzy
TEST_EXTRAS := plot,jazzy,dask,foxglove,test,ament
endif
DEMO_STAMP := $(VENV)/demo-with-ros-$(ROS)
TEST_STAMP := $(VENV)/test-with-ros-$(ROS)
PIP_INSTALL := $(VENV)/bin/pip install --quiet --disable-pip-version-check --editable
# Long tests are spread over all cores; a worker that has finished takes tests from the others.
PYTEST := $(VENV)/bin/python -m pytest -n auto --dist worksteal

DATA ?=

.PHONY: help demo reproduce docs test test-all test-oldest lint clean

help:  ## this list
	@awk -F ':.*## ' '/^[a-z-]+:.*## /{printf "make %-12s %s\n", $$1, $$2}' $(MAKEFILE_LIST)

demo: $(DEMO_STAMP)  ## simulator and estimator as two processes, a table and a picture
	$(VENV)/bin/fej_slam demo --force

reproduce: $(DEMO_STAMP)  ## the paper's tables and figures beside ours, in reproduced/ (DATA=FOLDER of the authors' files)
	$(VENV)/bin/fej_slam reproduce all $(if $(DATA),--data $(DATA)) --output reproduced --force

docs: $(DEMO_STAMP)  ## the pages in docs/ that are generated from the code
	$(VENV)/bin/python docs/generate.py
	$(VENV)/bin/python docs/generate_api.py

test: $(TEST_STAMP)  ## tests and linters, 5 to 8 minutes on two cores
	$(PYTEST)

# The kernel in the source tree becomes that of the oldest numpy, which newer ones cannot import:
# without these stamps, $(VENV) is installed again before it is used.
test-oldest:  ## the tests with the oldest supported libraries, those of Ubuntu 24.04
	rm -f $(TEST_STAMP) $(DEMO_STAMP)
	$(MAKE) test VENV=$(VENV)-oldest PIP_CONSTRAINT=$(CURDIR)/test/oldest.txt

test-all: test-oldest  ## all tests, before a release: network faults, soak runs, hundreds of seeds
	$(MAKE) $(TEST_STAMP)
	$(PYTEST) -m ''

lint: $(TEST_STAMP)  ## style, types and the import rule
	$(VENV)/bin/python -m pytest -m linter

clean:  ## remove what the other targets and colcon made
	rm -rf $(VENV) $(VENV)-oldest build install log demo*_output reproduced *.egg-info
	rm -f fej_slam_ros/core/ekf/_kernel*.so
	rm -rf .hypothesis .mypy_cache .pytest_cache .ruff_cache
	find . -name __pycache__ -prune -exec rm -rf {} +

# The COLCON_IGNORE keeps colcon from building the package.xml files of the ROS wheels.
$(VENV)/for-ros-$(ROS):
	$(PYTHON) -m venv --clear $(VENV_OPTIONS) $(VENV)
	touch $(VENV)/COLCON_IGNORE $@

KERNEL := fej_slam_ros/core/ekf/_kernel.c fej_slam_ros/core/ekf/_avx512.h

$(DEMO_STAMP): setup.py $(KERNEL) $(VENV)/for-ros-$(ROS)
	@echo 'Installing what the demo needs into $(VENV) ...'
	$(PIP_INSTALL) '.[$(DEMO_EXTRAS)]'
	touch $@

$(TEST_STAMP): setup.py $(KERNEL) $(VENV)/for-ros-$(ROS)
	@echo 'Installing what the tests need into $(VENV) ...'
	$(PIP_INSTALL) '.[$(TEST_EXTRAS)]'
	touch $@ $(DEMO_STAMP)
