"""A mission through the filter that has the true shaping states of its noise.

Beside the fifteen states of the core it has the slow error of the DVL and the shaping states of
prediction.py, with what the simulation knows of them (`simulation.mission.Noise`). Its records are
larger than those of the navigation filter; the kernels are the same. It has no gate, and outliers,
which belong to no noise, are left out.

Scale factors and misalignments are in none of its states. Counts are not either: what is carried to
the next sample is an error of the integral that stays within half a count.
"""

from dataclasses import replace

import numpy as np

from insdvl.navigation import kalman
from insdvl.navigation.events import NS, Initial
from insdvl.navigation.filter import Filter
from insdvl.navigation.measurements.base import Block, Linearised, Turn, Vehicle
from insdvl.navigation.measurements.dvl import Dvl
from insdvl.navigation.measurements.report import UpdateReport
from insdvl.navigation.parameters import FilterParameters
from insdvl.navigation.prediction.kept import Kept
from insdvl.navigation.start.initial_state import Start
from insdvl.navigation.state.fields import CORE
from insdvl.navigation.state.layout import layout
from insdvl.navigation.state.scratch import constants_type, workspace_type
from insdvl.simulation.drawn.imu_errors import FLICKER, FirstOrder
from insdvl.simulation.drawn.spectrum import flicker
from insdvl.simulation.mission import Mission, Noise
from insdvl.studies.evaluation.matched.prediction import predict
from insdvl.timeline.output import AppliedUpdate, FoldResult

#: Optional states: of the DVL, then in each channel of the IMU the flicker and the coloured noise.
_OPTIONAL = 3 + 6 * (len(flicker(1.0, *FLICKER)) + 1)
LAYOUT = layout((Dvl.name,), _OPTIONAL, {})

#: The vehicles of the evaluation have IMU and DVL at base_link, where no turn rate is needed.
_NO_TURN = Turn(np.zeros(3), np.zeros((3, 3)))


def vehicle_with(filter_: Filter, noise: Noise, shaping: int) -> tuple[Vehicle, list[Block]]:
    """The vehicle of a filter with the optional states of its noise, and these states.

    Args:
        filter_: A filter without optional states.
        noise: Of the mission.
        shaping: Number of shaping states.
    """
    blocks, places, n = [], {}, CORE
    if noise.dvl.bias_std > 0.0:
        of_dvl = (noise.dvl.bias_std,) * 3
        blocks.append(Block("dvl_error", of_dvl, noise.dvl.bias_time_constant))
    if shaping:
        blocks.append(Block("imu_error", (1.0,) * shaping))  # they decay at the end of a sample
    constants = np.zeros(1, constants_type(LAYOUT.size))
    for name in filter_.constants.dtype.names or ():
        if name not in ("variance", "decay"):
            constants[name] = filter_.constants[name]
    for block in blocks:
        places[block.name] = slice(n, n + len(block.std))
        n += len(block.std)
        at = slice(places[block.name].start - CORE, n - CORE)
        constants["variance"][0, at] = np.square(block.std)
        constants["decay"][0, at] = 1.0 / block.time_constant
    constants["n"] = n
    workspace = np.zeros(1, workspace_type(LAYOUT.size))
    vehicle = replace(filter_.vehicle, n=n, blocks=places, constants=constants, workspace=workspace)
    return vehicle, blocks


def first_order(mission: Mission) -> FirstOrder:
    """The first-order errors of a mission's IMU, with the variances in each sample (N, M)."""
    begins = np.concatenate([[mission.start_ns], mission.stamps_ns[:-1]]) - mission.start_ns
    imu = mission.noise.imu
    if imu is None:
        return FirstOrder(np.empty(0, np.intp), np.empty(0), np.empty((begins.size, 0)))
    return imu.first_order(begins / NS, interval(mission))


def interval(mission: Mission) -> float:
    """Time between samples [s]."""
    return float(mission.stamps_ns[-1] - mission.start_ns) / NS / len(mission.stamps_ns)


class _Flight:
    """The filter on its way through a mission.

    Args:
        mission: The mission.
        parameters: Of a filter without optional states.
        every: See `navigate`.
    """

    def __init__(self, mission: Mission, parameters: FilterParameters, every: int) -> None:
        noise, found = mission.noise, first_order(mission)
        self.filter = Filter(parameters)
        self._vehicle, self._blocks = vehicle_with(self.filter, noise, len(found.channels))
        self._dvl = parameters.dvl.model(self._vehicle)
        self._state = LAYOUT.empty()
        self._mission = mission
        self._readings = np.hstack([mission.f_b, mission.w_ib_b])
        self._sigma, self._channels = np.sqrt(found.variances), found.channels
        self._decay = np.exp(-interval(mission) / found.time_constants)
        self.kept = Kept(len(mission.stamps_ns), LAYOUT.dtype, every)
        self._next = 0  # sample

    def begin(self, initial: Initial) -> None:
        """Start with an initial state."""
        parameters = self.filter.parameters
        start = Start(parameters.initial, parameters.origin, self._vehicle, self._blocks)
        start.locate_from_parameters(self._state[0])
        start.initialise(self._state, initial, initial.stamp_ns, self._mission.w_ib_b[0])

    def advance(self, to_ns: int) -> None:
        """Advance to a stamp."""
        self._next = predict(
            self._state,
            self._vehicle.workspace,
            self._vehicle.constants,
            self._mission.stamps_ns,
            self._readings,
            self._mission.noise.white,
            self._sigma,
            self._channels,
            self._decay,
            self._next,
            to_ns,
            self.kept.every,
            self.kept.states,
            self.kept.numbers,
            self.kept.integers,
            self.kept.verdicts,
        )

    def take_in(self, ping: Dvl) -> UpdateReport:
        """Correct the state, which is at its stamp, with a ping."""
        now = kalman.innovate(self._state["nav"]["P"][0], *self._linearised(ping))
        kalman.correct(
            self._state,
            self._vehicle.constants,
            now,
            lambda: self._linearised(ping),
            self._vehicle.workspace,
            iterate=self._vehicle.invariant,
        )
        last = self._next - 1
        if last >= 0 and self._mission.stamps_ns[last] == ping.stamp_ns:
            self.kept.put(self._state, last)  # behind the update
        return UpdateReport(ping.name, now.innovation, now.S, now.nis, True, "")

    def _linearised(self, ping: Dvl) -> Linearised:
        return self._dvl.linearise(self._state, ping, _NO_TURN)


def navigate(
    mission: Mission, initial: Initial, parameters: FilterParameters, every: int
) -> FoldResult:
    """The mission through the filter that knows all of its noise.

    Args:
        mission: The mission.
        initial: State at its start.
        parameters: Of the filter: error state, initial covariance, walks of the biases.
        every: Of so many samples the whole state of the last one is kept.

    Returns:
        As of `fold_arrays`. Its filter is one without optional states: the core's come first in the
        records.

    Raises:
        ValueError: Vibration of the vehicle is aliased in the samples; no shaping state makes that.
    """
    noise = mission.noise
    if noise.imu is not None and noise.imu.lines:
        frequencies = ", ".join(f"{line.frequency:.3g}" for line in noise.imu.lines)
        raise ValueError(
            f"the filter with true shaping states has none for aliased vibration, at {frequencies} "
            "Hz in the samples: simulate an IMU of a higher rate"
        )
    flight, updates = _Flight(mission, parameters, every), []
    flight.begin(initial)
    known = mission.without_outliers()
    pings = zip(known.dvl_stamps_ns.tolist(), known.v_d, known.noise.white_r, strict=True)
    for stamp_ns, v_d, r in pings:
        flight.advance(stamp_ns)
        updates.append(AppliedUpdate(stamp_ns, flight.take_in(Dvl(stamp_ns, v_d, np.diag(r)))))
    flight.advance(int(mission.stamps_ns[-1]))
    return FoldResult(flight.filter, flight.kept.states, flight.kept.track, updates, {}, {})
