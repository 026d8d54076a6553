"""Compile the hot functions of simulator, filter and tuner, so that programs start quickly."""

from insdvl.navigation.parameters import FilterParameters
from insdvl.simulation.mission import mission_of
from insdvl.simulation.parameters import SimulatorParameters
from insdvl.timeline.fold import run
from insdvl.tuner.parameters import TunerParameters
from insdvl.tuner.tuner import Tuner
from ros_insdvl.filter import compile_kernels

mission = mission_of(SimulatorParameters())
run(FilterParameters(), mission.stamps_ns, mission.f_b, mission.w_ib_b, [])
compile_kernels(FilterParameters())
Tuner(TunerParameters())
