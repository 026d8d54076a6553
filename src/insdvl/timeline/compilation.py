"""The functions of the filter, compiled before the first message comes."""

from dataclasses import replace

import numpy as np

from insdvl.navigation.events import NS, Event, Imu, ProcessNoise
from insdvl.navigation.filter import LAYOUT
from insdvl.navigation.gate import ordinary
from insdvl.navigation.geometry.frames import rotation_from_quaternion, rotation_from_vector
from insdvl.navigation.measurement_noise import levels
from insdvl.navigation.measurements.depth import Depth
from insdvl.navigation.measurements.dvl import Dvl
from insdvl.navigation.measurements.heading import Heading
from insdvl.navigation.parameters import FilterParameters
from insdvl.navigation.process_noise import bank, factor
from insdvl.navigation.start import gyrocompass
from insdvl.navigation.state.fields import NEVER
from insdvl.timeline.fold import Fold


def compile_fold(parameters: FilterParameters) -> None:
    """Run a filter for a moment, so that no message ever waits for a compilation.

    Its measurements come between two samples, as those of a sensor do, and its channels freeze. The
    first one corrects so much that it is of second order, the next one is ordinary and tells its
    noise. Then the gate meets measurements that do not fit.
    """
    at_once = replace(
        parameters,
        initial=replace(
            parameters.initial, mode="parameters", heading="auto", velocity_std=100.0, tilt_std=0.1
        ),
        origin=replace(parameters.origin, source="parameters"),
        output_delay=0.0,
    )
    step = round(NS / parameters.imu.rate)
    samples: list[Event] = [
        Imu(k * step, np.array([0.0, 0.0, -9.8]), np.zeros(3)) for k in range(1, 5)
    ]
    measured: list[Event] = [
        ProcessNoise(2 * step - step // 2, np.eye(3), np.eye(3)),
        Dvl(3 * step - step // 2, np.full(3, 0.01)),
        Dvl(4 * step - step // 2, np.full(3, 0.02), np.eye(3)),
        Depth(4 * step - step // 3, 1.0),
        Heading(4 * step - step // 4, np.eye(3)),
    ]
    misfits: list[Event] = []
    for k, off in enumerate((0.0, 5.0, 5.0, 0.0)):
        misfits += [Dvl((k + 1) * step - step // 2, np.full(3, 0.01 + off), 1e-4 * np.eye(3))]
        misfits += [Depth((k + 1) * step - step // 3, 1.0 + off, 1e-4)]
    freezing = replace(at_once, imu=replace(at_once.imu, frozen_samples=2))
    for gate, events in ((False, measured), (True, misfits)):
        fold = Fold(replace(freezing, gate=replace(at_once.gate, enabled=gate)))
        for event in samples + events:
            fold.add(event)
        fold.take()
    ordinary.note_claim(np.zeros(3), np.zeros(3), NEVER, NEVER, np.zeros(3))
    # As the attitudes of messages, and of a heading.
    rotation_from_vector(np.zeros(3))
    rotation_from_quaternion(np.array([0.0, 0.0, 0.0, 1.0]))
    one = levels.Whitened(np.ones(3), np.ones(3))
    _compile_bank()
    levels.learned(levels.moved(levels.PRIOR, 1.0), one, levels.SMALLEST)
    gyrocompass.jacobian(np.eye(3), 0.0, 0.0)  # calls the Earth's rate and gravity, as a start does


def _compile_bank() -> None:
    """The bank begins anew with each frozen sample, so a frozen IMU does not compile it."""
    state = LAYOUT.empty()[0]
    m, nav, eye = state[factor.GROUP], state["nav"], np.eye(3)
    H, M = np.eye(3, bank.SIZE), np.zeros((3, 3))
    bank.advance(m["errors"], m["P"], nav["C_n_b"], nav["v_n"], 9.8, eye, eye, 0.0, 0.0, 1.0)
    bank.correct(m["errors"], m["P"], 1.0, H, np.zeros(3), eye, M, np.empty(bank.LEVELS.size))
