"""Metrics on numbers that can be checked by hand."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from insdvl.studies.evaluation.metrics import (
    Track,
    attitude_error,
    inside_fraction,
    path_length,
    rmse,
    scores,
    smae,
)


def straight(n: int = 5) -> Track:
    """1 m/s along the first axis, one stamp per second."""
    p_o = np.zeros((n, 3))
    p_o[:, 0] = np.arange(n)
    return Track(np.tile(np.eye(3), (n, 1, 1)), np.tile([1.0, 0.0, 0.0], (n, 1)), p_o)


def test_rmse_and_smae_by_hand() -> None:
    error = np.array([[3.0, 4.0, 0.0], [0.0, 0.0, -1.0]])
    assert rmse(error) == pytest.approx(np.sqrt((25.0 + 1.0) / 2.0))
    assert smae(error) == pytest.approx((7.0 + 1.0) / 2.0)
    assert rmse(np.array([3.0, 4.0])) == pytest.approx(np.sqrt(12.5))


def test_attitude_error_is_about_navigation_axes() -> None:
    C = Rotation.from_euler("xyz", [[0.3, 0.2, 1.0]]).as_matrix()
    psi = np.array([0.01, -0.02, 0.03])
    C_true = Rotation.from_rotvec(psi).as_matrix() @ C
    np.testing.assert_allclose(attitude_error(C, C_true), [psi], atol=1e-12)


def test_perfect_result_scores_zero() -> None:
    assert set(vars(scores(straight(), straight())).values()) == {0.0}


def test_heading_error_is_no_error_in_body_axes() -> None:
    truth = straight()
    C = Rotation.from_rotvec([0.0, 0.0, np.radians(90.0)]).as_matrix()
    turned = replace(truth, C_n_b=np.tile(C, (5, 1, 1)))
    found = scores(turned, truth)
    assert found.body_velocity_rmse == 0.0
    assert found.heading_rmse_deg == pytest.approx(90.0)
    assert found.tilt_rmse_deg == pytest.approx(0.0, abs=1e-12)
    assert found.srmse == pytest.approx(np.sqrt(2.0))  # (1, 0) taken for (0, 1)
    assert found.smae == pytest.approx(2.0)


def test_position_is_horizontal_and_drift_in_percent_of_the_way() -> None:
    truth = straight()
    offset = np.zeros((5, 3))
    offset[-1] = [0.0, 0.4, 100.0]
    found = scores(replace(truth, p_o=truth.p_o + offset), truth)
    assert found.position_rmse_horizontal == pytest.approx(0.4 / np.sqrt(5.0))
    assert found.position_drift_percent == pytest.approx(10.0)
    still = replace(truth, p_o=np.zeros((5, 3)))
    assert np.isnan(scores(still, still).position_drift_percent)


def test_path_length_follows_the_path() -> None:
    assert path_length(np.array([[0.0, 0, 0], [3, 4, 0], [3, 4, 12], [3, 4, 0]])) == 29.0


def test_inside_fraction_counts_components() -> None:
    error = np.array([[0.1, -0.31], [0.3, 0.0]])
    assert inside_fraction(error, np.full((2, 2), 0.1)) == 0.75
    assert inside_fraction(error, np.full((2, 2), 0.1), times=1.0) == 0.5
