# make demo         run the navigation graph; ARGS="--seed 3 --scenario wide"
# make test         run the fast tests, 6 minutes on two quiet cores; ARGS="-k filter"
# make test-all     run all tests, the long ones included, 40 minutes
# make test-jazzy   run all tests with the library versions of ROS 2 Jazzy; needs Python 3.12
# make test-core    run the fast tests of the core alone with those versions: no ROS, any platform
# make results      recompute docs/results/, some hours on two cores; ARGS="--recordings DIR --config FILE"
# make consistency  fly docs/results/consistency.md again, about 50 minutes on two quiet cores
# make faults       fly the fault matrix of docs/reliability.md again, about half an hour
# make soak         add an hour of mission to the soak there; ARGS="--hours 2"
# make bench        time the filter against the same work in C and against other filters
# make bench-nodes  time the nodes: CPU per IMU message, memory, messages lost
# make bench-check  fail where a ratio of them is 20 % worse than benchmarks/speed.json
# make bench-scaling  measure how the cost grows, for docs/explanation/performance.md
# make clean        remove what set-up and builds made
#
# Each sets up the environment when it runs first and rebuilds what changed; all but the demo then
# add what tests and studies need.
# PYTHON=python3.11 selects the interpreter of the first set-up.

# A ROS 2 that was sourced in this shell must not leak into the environment.
unexport AMENT_PREFIX_PATH CMAKE_PREFIX_PATH COLCON_PREFIX_PATH LD_LIBRARY_PATH PYTHONHOME PYTHONPATH
unexport FASTRTPS_DEFAULT_PROFILES_FILE RMW_IMPLEMENTATION VIRTUAL_ENV _ROS_WHEELS_BOOTSTRAP_COMPLETE

ARGS ?=
# Two processes; the tests of one file stay together and share costly set-ups.
PYTEST := pytest -n 2 --dist loadfile
# Folders are listed too, so that a deleted file triggers a build.
SOURCES := $(shell find src ros_insdvl ros_insdvl_sim models tools/build.sh \
	-name __pycache__ -prune -o -name '*.egg-info' -prune -o -print)

.PHONY: demo test test-all test-jazzy test-core bench bench-nodes bench-check bench-scaling results \
	consistency faults soak clean
.DELETE_ON_ERROR:
# Made on the way to others, and kept.
.PRECIOUS: %/.installed %/.built %/.complete

demo: .venv/.built
	AMENT_PREFIX_PATH=$(CURDIR)/.venv .venv/lib/ros_insdvl_sim/demo $(ARGS)

results consistency: .venv/.whole
	.venv/bin/insdvl $@ $(ARGS)

bench: .venv/.whole
	.venv/bin/python benchmarks/speed.py $(ARGS)

bench-nodes: .venv/.whole
	AMENT_PREFIX_PATH=$(CURDIR)/.venv .venv/bin/python benchmarks/nodes.py $(ARGS)

bench-check: .venv/.whole
	.venv/bin/python benchmarks/speed.py --check benchmarks/speed.json $(ARGS)

bench-scaling: .venv/.whole
	.venv/bin/python benchmarks/scaling.py $(ARGS)

faults soak: .venv/.whole
	AMENT_PREFIX_PATH=$(CURDIR)/.venv .venv/lib/ros_insdvl_sim/$@ $(ARGS)

test: .venv/.whole
	AMENT_PREFIX_PATH=$(CURDIR)/.venv .venv/bin/$(PYTEST) -m "not long" $(ARGS)

test-all: .venv/.whole
	AMENT_PREFIX_PATH=$(CURDIR)/.venv .venv/bin/$(PYTEST) $(ARGS)

test-jazzy: .venv-jazzy/.whole
	AMENT_PREFIX_PATH=$(CURDIR)/.venv-jazzy .venv-jazzy/bin/$(PYTEST) $(ARGS)

test-core: .venv-core/.built
	.venv-core/bin/$(PYTEST) -m "not long" test/core $(ARGS)

.venv/.installed: requirements.txt constraints.txt tools/environment.sh
	@tools/environment.sh .venv
	@touch $@

.venv-jazzy/.installed: requirements.txt constraints.txt constraints-jazzy.txt tools/environment.sh
	@VERSIONS=3.12 tools/environment.sh .venv-jazzy constraints-jazzy.txt
	@touch $@

.venv-core/.installed: src/setup.py constraints.txt constraints-jazzy.txt tools/environment.sh
	@CORE=yes VERSIONS=3.12 tools/environment.sh .venv-core constraints-jazzy.txt
	@touch $@

.venv-core/.built: .venv-core/.installed $(SOURCES)
	@.venv-core/bin/python -m pip install --quiet --disable-pip-version-check \
		--no-build-isolation --no-deps --force-reinstall ./src
	@rm -rf src/build src/insdvl.egg-info
	@touch $@

%/.built: %/.installed $(SOURCES)
	@tools/build.sh $*
	@touch $@

# What was built needs nothing of this; so it is not built again for it.
%/.complete: %/.installed requirements-test.txt
	@MORE=yes tools/environment.sh $*
	@touch $@

%/.whole: %/.built %/.complete
	@touch $@

clean:
	rm -rf .venv .venv-core .venv-jazzy build install log
	find src ros_insdvl ros_insdvl_sim test -name __pycache__ -prune -exec rm -rf {} +
