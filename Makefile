# make demo         sets up, then runs the navigation graph; ARGS="--seed 3 --scenario wide"
# make test         sets up, then runs the tests; ARGS="-k filter"
# make test-jazzy   the tests with the library versions of a full ROS 2 Jazzy; needs a Python 3.12
# make results      computes docs/results.md again: about an hour; ARGS="--recordings DIR --config FILE"
# make faults       flies the fault matrix of docs/reliability.md again: about half an hour
# make soak         adds an hour of mission to the soak there; ARGS="--hours 2"
# make clean        removes what the set-up and the builds made
# PYTHON=python3.11 names the interpreter for a first set-up.

# The environment is our own: a ROS 2 that was sourced in this shell must not leak into it.
unexport AMENT_PREFIX_PATH CMAKE_PREFIX_PATH COLCON_PREFIX_PATH LD_LIBRARY_PATH PYTHONHOME PYTHONPATH
unexport FASTRTPS_DEFAULT_PROFILES_FILE RMW_IMPLEMENTATION VIRTUAL_ENV _ROS_WHEELS_BOOTSTRAP_COMPLETE

ARGS ?=
# Two at a time; the tests of a file share what is costly to make.
PYTEST := pytest -n 2 --dist loadfile
# Folders are in the list so that a deleted file is noticed as well.
SOURCES := $(shell find src ros_insdvl ros_insdvl_sim models tools/build.sh tools/warm.py \
	-name __pycache__ -prune -o -name '*.egg-info' -prune -o -print)

.PHONY: demo test test-jazzy results faults soak clean
.DELETE_ON_ERROR:

demo: .venv/.built
	AMENT_PREFIX_PATH=$(CURDIR)/.venv .venv/lib/ros_insdvl_sim/demo $(ARGS)

results: .venv/.built
	.venv/bin/insdvl results $(ARGS)

faults soak: .venv/.built
	AMENT_PREFIX_PATH=$(CURDIR)/.venv .venv/lib/ros_insdvl_sim/$@ $(ARGS)

test: .venv/.built
	AMENT_PREFIX_PATH=$(CURDIR)/.venv .venv/bin/$(PYTEST) $(ARGS)

test-jazzy: .venv-jazzy/.built
	AMENT_PREFIX_PATH=$(CURDIR)/.venv-jazzy .venv-jazzy/bin/$(PYTEST) $(ARGS)

.venv/.installed: requirements.txt constraints.txt tools/environment.sh
	@tools/environment.sh .venv
	@touch $@

.venv-jazzy/.installed: requirements.txt constraints.txt constraints-jazzy.txt tools/environment.sh
	@VERSIONS=3.12 tools/environment.sh .venv-jazzy constraints-jazzy.txt
	@touch $@

%/.built: %/.installed $(SOURCES)
	@tools/build.sh $*
	@touch $@

clean:
	rm -rf .venv .venv-jazzy build install log
	find src ros_insdvl ros_insdvl_sim test -name __pycache__ -prune -exec rm -rf {} +
