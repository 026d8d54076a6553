"""What a measurement is: the protocol that every sensor follows.

A sensor brings one file with

- its parameters, a dataclass derived from `SensorParameters`;
- its measurement, a frozen event derived from `events.Measurement`;
- its model, derived from `SensorModel`: the prediction of the measurement and its Jacobian;
- where it needs them, optional error states, as `Block`s.

The order of events, the cut of the IMU, the gate, the Kalman algebra, the report, the state file
and the diagnostics are common and know m rows, not the sensor. docs/how-to/extending.md shows a
whole example.
"""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Generic, NamedTuple, TypeVar

import numpy as np

from insdvl.arrays import Array, Records
from insdvl.navigation.events import Measurement
from insdvl.navigation.geometry.frames import Convention
from insdvl.navigation.state.fields import CORE, State

_Event = TypeVar("_Event", bound=Measurement)


@dataclass(frozen=True)
class Block:
    """Optional error states: independent first-order Gauss-Markov processes, or constants.

    Attributes:
        name: Unique among all blocks.
        std: Initial and stationary sigma of each state; their number is the size of the block.
        time_constant: Correlation time [s]; infinite for constants.
        initial: Value of each state at the start.
    """

    name: str
    std: tuple[float, ...]
    time_constant: float = np.inf
    initial: tuple[float, ...] = ()


@dataclass(frozen=True)
class Vehicle:
    """What a sensor's model needs to know of the vehicle and of the filter.

    Attributes:
        axes: Convention of the parameters and of the stream.
        C_b_i: (3, 3) rotation from IMU to base_link axes, forward-right-down.
        l_b_imu: (3,) position of the IMU in base_link [m], forward-right-down.
        invariant: Whether the error state is the invariant one.
        n: Number of error states in use.
        blocks: Indices of each optional block that is in use.
        gyroscope_bias_std: Of each axis at the start, one sigma [rad/s].
        constants: (1,) record of the filter.
        workspace: (1,) record of the filter; `g_n` is gravity at the last linearised state.
    """

    axes: Convention
    C_b_i: Array
    l_b_imu: Array
    invariant: bool
    n: int
    blocks: Mapping[str, slice]
    gyroscope_bias_std: float
    constants: Records
    workspace: Records

    def optional(self, block: str) -> slice:
        """Indices of a block in the nominal ``optional`` states."""
        at = self.blocks[block]
        return slice(at.start - CORE, at.stop - CORE)

    def lever_arm(self, position: tuple[float, ...]) -> Array:
        """(3,) from the IMU to a sensor [m], base_link axes, forward-right-down.

        Args:
            position: Of the sensor in base_link, in the axes of the parameters.
        """
        return self.axes.body @ np.array(position) - self.l_b_imu


class Turn(NamedTuple):
    """The turn rate at a measurement.

    Attributes:
        w_ib_b: (3,) angular rate at the stamp [rad/s], base_link axes, with its bias and without
            that of channels that do not show the motion.
        covariance: (3, 3) of that rate [(rad/s)^2].
    """

    w_ib_b: Array
    covariance: Array


class Past(NamedTuple):
    """What a sensor has read before a measurement.

    Attributes:
        readings: (k, m) the last ones that no claim of their own has refused, the newest first.
        equal: How many of them the measurement repeats.
        repeats: How many readings in a row before the measurement were equal to it.
        contradicted: Whether the gate has rejected the measurement before it.
    """

    readings: Array
    equal: int
    repeats: int
    contradicted: bool


class Linearised(NamedTuple):
    """A measurement at a state: z - h = H dx + noise.

    A component that was not measured has a row of zeros in H, an innovation of zero, and noise that
    is independent of the others'. Its row of the gain is then zero, its share of the NIS too.

    Attributes:
        z_minus_h: (m,) measured minus predicted.
        H: (m, n) Jacobian of the prediction with respect to the error state.
        R: (m, m) covariance of the measurement noise.
    """

    z_minus_h: Array
    H: Array
    R: Array


class SensorModel(ABC, Generic[_Event]):
    """How one kind of measurement follows from the state.

    Attributes:
        label: What an operator calls the sensor.
        rows: Number of rows m.
        tells_velocity: Whether it tells velocity and, with the IMU, tilt: an adaptive process noise
            learns from it, and the doubt about IMU channels starts again with it.
        absolute: Whether it tells heading or position against the Earth: what it corrects there
            moves map -> odom, not odom.
        angles: Whether its rows are turns about the last axes of the stream, x, y, z.
        turn_window_ns: Time before it that its turn rate is taken from; 0 takes one sample.
        interval_ns: A measurement that follows the last judged one sooner is left out.
        noise_source: Where the covariance of its noise comes from, see measurement_noise/.
        noise_floor: Smallest sigma that an estimate of its noise may reach.
    """

    label: ClassVar[str]
    rows: ClassVar[int]
    tells_velocity: ClassVar[bool] = False
    absolute: ClassVar[bool] = False
    angles: ClassVar[bool] = False
    turn_window_ns: int = 0
    interval_ns: int = 0
    noise_source: str = "nominal"
    noise_floor: float = 0.0

    @abstractmethod
    def reading(self, event: _Event) -> Array:
        """(m,) what was read, to tell whether it repeats an earlier one."""

    @abstractmethod
    def refusal(self, event: _Event, past: Past) -> str:
        """Why the measurement says by itself that it is none; empty where it does not.

        It is asked before anything is predicted. A refused measurement changes nothing: neither the
        state nor the memory of the gate.

        Args:
            event: The measurement.
            past: What was read before it.
        """

    def noise(self, event: _Event) -> Array:
        """Nominal covariance (m, m) of the measurement's own noise, where `noise_source` is not."""
        raise TypeError(f"{type(self).__name__} has no noise to estimate")

    def claims_rest(self, event: _Event) -> bool:
        """Whether what `refusal` refuses may be the zero velocity of a vehicle at rest."""
        return False

    def velocity(self, event: _Event, turn: Turn) -> tuple[Array, Array] | None:
        """Velocity (3,) of base_link in body axes and its covariance, without any state.

        None where the measurement does not tell it.
        """
        return None

    def attitude(self, event: _Event) -> tuple[Array, float] | None:
        """C_n_b (3, 3), of which the heading is told, and one sigma of that [rad].

        None where the measurement does not tell it.
        """
        return None

    @abstractmethod
    def linearise(self, state: Records, event: _Event, turn: Turn) -> Linearised:
        """The measurement at a state, which is at its stamp.

        Args:
            state: (1,) record.
            event: The measurement.
            turn: The turn rate there.
        """

    def take_in(
        self,
        state: Records,
        memory: Records,
        event: _Event,
        w_ib_b: Array,
        share: Array,
        limits: Array,
        patience_ns: int,
    ) -> tuple[Array, Array, float] | None:
        """Judge and use an ordinary measurement at once; for a sensor that has a kernel for it.

        Args:
            state: (1,) record, initialised, at the stamp.
            memory: (1,) of the gate, a part of it.
            event: The measurement.
            w_ib_b: (3,) angular rate at the stamp [rad/s], base_link axes.
            share: (3,) its variance, in units of that of one sample.
            limits: (m + 1,) of the NIS, by the number of rows that were measured.
            patience_ns: Most trust that the filter gains.

        Returns:
            Innovation (m,), its covariance (m, m) and NIS; None where the measurement is not
            ordinary, and the state is as it was.
        """
        return None

    def in_stream(self, innovation: Array, S: Array) -> tuple[Array, Array]:
        """An innovation (m,) and its covariance (m, m) in the axes of the stream."""
        return innovation, S

    @abstractmethod
    def drift(self, s: State, seconds: float) -> Array:
        """Covariance (m, m) of what the prediction may have drifted over a time by the IMU alone.

        In the coordinates of the innovation; the white noise of the measurement is not in it.
        """

    @abstractmethod
    def inflate(self, s: State, innovation: Array, seconds: float | None) -> None:
        """Doubt what the measurement tells of, by as much as the innovation.

        Args:
            s: State; its covariance becomes larger.
            innovation: (m,) of the measurement.
            seconds: In which the state has drifted; None where a drift explains nothing.
        """

    @abstractmethod
    def restart(self, s: State, innovation: Array, R: Array) -> None:
        """Set what the measurement tells of from this measurement alone.

        Args:
            s: State; becomes what the measurement says, independent of all else.
            innovation: (m,) of the measurement.
            R: (m, m) covariance of its noise.
        """


@dataclass(frozen=True)
class SensorParameters:
    """Parameters of a sensor; a field of `FilterParameters` whose name is the measurement's.

    Attributes:
        time_offset: Is added to the stamps of its measurements [s]; every sensor declares it.
        EVENT: Class of its measurements.
        ROOM: Largest size of each optional block that it may bring, by name.
        REMEDIES: What the reasons of its own mean for which a measurement is refused, and what to
            do about them.
    """

    EVENT: ClassVar[type[Measurement]]
    ROOM: ClassVar[Mapping[str, int]] = {}
    REMEDIES: ClassVar[Mapping[str, str]] = {}

    def blocks(self) -> tuple[Block, ...]:
        """The optional blocks that are in use."""
        return ()

    def model(self, vehicle: Vehicle) -> "SensorModel[Any]":
        """The sensor's model in a vehicle."""
        raise TypeError(f"{type(self).__name__} has no model")
