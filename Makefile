# make demo   three virtual experiments through the real nodes, with a table of errors against the truth
# make check  style, types, import contracts, unit tests of the library
# make test   make check, then tests of the nodes, the running system, the pages and the notebooks
# make coverage       make check with the lines that the unit tests of the library leave out
# make test-stock     the tests that need a sourced ROS 2 installation with its tools
# make test-matrix    every ROS 2 distribution with every Python of this computer, in fresh clones; 10 minutes each
# make test-hardware  the tests that need system packages: real devices, a browser
# make docs   the documentation site in docs/_build/html, warnings are errors; the list of installed packages (CycloneDX)
# make bench  measured figures with their targets
# make setup  environment, ROS 2 and workspace, which the other targets need and call
# make clean  removes everything that was built

SHELL := /bin/bash
ENVIRONMENT := . setup/environment.sh
OUTPUT ?= demo

.PHONY: help setup demo check test coverage test-stock test-matrix test-hardware docs bench clean

help:
	@sed -n 's/^# make/make/p' Makefile

setup:
	@setup/setup.sh

demo: setup
	@$(ENVIRONMENT) && fringedic demo --output $(OUTPUT)

check: setup
	@$(ENVIRONMENT) && setup/check.sh library

test: setup
	@$(ENVIRONMENT) && setup/check.sh

coverage: setup
	@$(ENVIRONMENT) && COVERAGE=yes setup/check.sh library

test-stock: setup
	@$(ENVIRONMENT) && python -m pytest -m stock

test-matrix: setup
	@$(ENVIRONMENT) && python benchmarks/distributions.py

test-hardware: setup
	@setup/hardware.sh && $(ENVIRONMENT) && python -m pytest -m "hardware or browser"

docs: setup
	@$(ENVIRONMENT) && python -m sphinx --fail-on-warning --keep-going --quiet docs docs/_build/html
	@$(ENVIRONMENT) && python setup/bill_of_materials.py docs/_build/sbom.cdx.json
	@echo "docs: open docs/_build/html/index.html; installed packages with licences: docs/_build/sbom.cdx.json"

bench: setup
	@$(ENVIRONMENT) && python benchmarks/run.py

clean:
	rm -rf .venv .setup.lock setup.log* docs/_build ros2_ws/build ros2_ws/install ros2_ws/log
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
