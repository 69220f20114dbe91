# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0

PYTHON ?= python3
VENV := .venv

# Where ROS 2 Jazzy is sourced it is used; elsewhere it comes from PyPI.
ifeq ($(shell [ "$$ROS_DISTRO" = jazzy ] && $(PYTHON) -c 'import rclpy' 2>/dev/null && echo sourced),sourced)
ROS := sourced
VENV_OPTIONS := --system-site-packages
EXTRAS := plot,dask,foxglove,test
else
ROS := pypi
VENV_OPTIONS :=
EXTRAS := plot,dask,foxglove,test,ament,jazzy
endif
STAMP := $(VENV)/installed-with-ros-$(ROS)

DATA ?=

.PHONY: help demo reproduce docs test test-all lint clean

help:  ## this list
	@awk -F ':.*## ' '/^[a-z-]+:.*## /{printf "make %-10s %s\n", $$1, $$2}' $(MAKEFILE_LIST)

demo: $(STAMP)  ## simulator and estimator as two processes, a table and a picture
	$(VENV)/bin/fej_slam demo --force

reproduce: $(STAMP)  ## the paper's tables and figures beside ours, in reproduced/ (DATA=FOLDER of the authors' files)
	$(VENV)/bin/fej_slam reproduce all $(if $(DATA),--data $(DATA)) --output reproduced --force

docs: $(STAMP)  ## the pages in docs/ that are generated from the code
	$(VENV)/bin/python docs/generate.py

test: $(STAMP)  ## everything but the long runs
	$(VENV)/bin/python -m pytest -n auto --dist loadscope -m 'not slow'

test-all: $(STAMP)  ## everything, as before a release
	$(VENV)/bin/python -m pytest -n auto --dist loadscope

lint: $(STAMP)  ## style, types and the import rule
	$(VENV)/bin/python -m pytest -m linter

clean:  ## remove what the other targets and colcon made
	rm -rf $(VENV) build install log demo_output reproduced *.egg-info
	rm -rf .hypothesis .mypy_cache .pytest_cache .ruff_cache
	find . -name __pycache__ -prune -exec rm -rf {} +

# The COLCON_IGNORE keeps colcon from building the package.xml files of the ROS wheels.
$(STAMP): setup.py
	@echo 'Setting up $(VENV), which takes about a minute and 750 MB ...'
	$(PYTHON) -m venv --clear $(VENV_OPTIONS) $(VENV)
	touch $(VENV)/COLCON_IGNORE
	$(VENV)/bin/pip install --quiet --disable-pip-version-check --editable '.[$(EXTRAS)]'
	touch $@
