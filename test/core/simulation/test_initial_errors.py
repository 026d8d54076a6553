"""Initial states with errors drawn from P_0."""

from dataclasses import replace

import numpy as np
import pytest

from insdvl.simulation.initial_errors import P_0, drawn_initial
from insdvl.simulation.trajectories import AUV
from insdvl.studies.evaluation.metrics import attitude_error

SIGMA = replace(P_0, tilt_std=0.01, heading_std=0.05, velocity_std=0.2, position_std=3.0)
TRUTH = AUV.truth([100.0, 200.0])
C, V_N, P_N = TRUTH.C_n_b[0], TRUTH.v_n[0], TRUTH.p_o[0]


def errors(initial):
    """Nine errors, the velocity's in the frame in which it is declared."""
    v = C.T @ V_N if initial.velocity_frame == "body" else V_N
    psi = attitude_error(initial.C_o_b[None], C[None])[0]
    return np.concatenate([psi, initial.v - v, initial.p_o - P_N])


@pytest.mark.parametrize("frame", ["body", "nav"])
def test_errors_have_the_declared_covariance_in_the_declared_frame(frame):
    sigma, rng = replace(SIGMA, velocity_frame=frame), np.random.default_rng(1)
    drawn = np.array([errors(drawn_initial(TRUTH, sigma, rng)) for _ in range(2000)])
    expected = np.diag(np.square([0.01, 0.01, 0.05] + [0.2] * 3 + [3.0] * 3))
    scale = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
    # The standard error of a correlation is 2.2 %, that of a variance 3.2 %.
    np.testing.assert_allclose(np.cov(drawn.T) / scale, expected / scale, atol=0.14)
    np.testing.assert_allclose(drawn.mean(axis=0) / np.sqrt(np.diag(expected)), 0.0, atol=0.1)


def test_a_true_position_takes_no_draw():
    with_error, without = np.random.default_rng(2), np.random.default_rng(2)
    initial = drawn_initial(TRUTH, SIGMA, without, stamp_ns=7, with_position=False)
    other = drawn_initial(TRUTH, SIGMA, with_error)
    np.testing.assert_array_equal(initial.p_o, P_N)
    np.testing.assert_array_equal(initial.C_o_b, other.C_o_b)
    assert initial.stamp_ns == 7
    with_error.bit_generator.state = np.random.default_rng(2).bit_generator.state
    with_error.standard_normal(6)
    np.testing.assert_array_equal(without.standard_normal(3), with_error.standard_normal(3))


def test_a_uniform_heading_leaves_the_tilt_and_all_other_errors_as_they_are():
    normal = drawn_initial(TRUTH, SIGMA, np.random.default_rng(3))
    drawn = [
        drawn_initial(TRUTH, SIGMA, np.random.default_rng([3, seed]), uniform_heading=True)
        for seed in range(2000)
    ]
    # The vertical that the vehicle sees is off by the tilt, whatever the heading is.
    up = np.array([C @ initial.C_o_b[2] for initial in drawn])
    np.testing.assert_allclose(up[:, :2].std(axis=0), 0.01, rtol=0.1)
    turn = np.array([C @ initial.C_o_b.T for initial in drawn])
    heading = np.arctan2(turn[:, 1, 0], turn[:, 0, 0])
    quarters = np.histogram(heading, bins=4, range=(-np.pi, np.pi))[0]
    assert np.all(np.abs(quarters - 500) < 4 * np.sqrt(2000 * 0.25 * 0.75))
    other = drawn_initial(TRUTH, replace(SIGMA, heading_std=2.0), np.random.default_rng(3))
    np.testing.assert_array_equal(other.p_o, normal.p_o)
    np.testing.assert_array_equal(other.v, normal.v)
    tilts = [np.hypot(*(C @ initial.C_o_b[2])[:2]) for initial in (normal, other)]
    assert tilts[0] == pytest.approx(tilts[1], rel=1e-9)
