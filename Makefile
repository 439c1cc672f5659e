# make demo   three virtual experiments through the real nodes, with a table of errors against the truth
# make test   style, types, unit tests and tests of the running system
# make test-hardware  the tests that need system packages for real devices, none left out
# make bench  measured figures beside their targets
# make setup  only what the others need: environment, ROS 2, workspace (each of them calls it)
# make clean  removes everything that was built or measured

SHELL := /bin/bash
ENVIRONMENT := . setup/environment.sh
OUTPUT ?= demo

.PHONY: help setup demo test test-hardware bench clean

help:
	@sed -n 's/^# make/make/p' Makefile

setup:
	@setup/setup.sh

demo: setup
	@$(ENVIRONMENT) && fringedic demo --output $(OUTPUT)

test: setup
	@$(ENVIRONMENT) && setup/check.sh

test-hardware: setup
	@setup/hardware.sh && $(ENVIRONMENT) && python -m pytest -m hardware

bench: setup
	@$(ENVIRONMENT) && python benchmarks/run.py

clean:
	rm -rf .venv .setup.lock setup.log ros2_ws/build ros2_ws/install ros2_ws/log
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
