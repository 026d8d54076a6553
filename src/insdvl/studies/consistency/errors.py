"""Errors of attitude, body velocity and biases against their covariance, at times of one run."""

from dataclasses import dataclass

import numpy as np

from insdvl.arrays import Array, Records
from insdvl.navigation.coordinates import attitude_error, body_velocity_jacobian
from insdvl.navigation.error_state import ATTITUDE
from insdvl.navigation.filter import Filter
from insdvl.simulation.mission import Mission

_BIASES = slice(6, 12)


@dataclass(frozen=True)
class Errors:
    """Errors at times (K,) of one run; each NEES is per degree of freedom.

    Attributes:
        attitude: NEES of the error in the coordinates of the model, 3 degrees of freedom.
        heading: NEES of its third component.
        velocity: NEES of the velocity in body axes, 3 degrees of freedom.
        biases: NEES of both triads, 6 degrees of freedom.
        heading_deg: Error of the heading.
        heading_sigma_deg: What the filter says of it.
    """

    attitude: Array
    heading: Array
    velocity: Array
    biases: Array
    heading_deg: Array
    heading_sigma_deg: Array


def errors(filter_: Filter, states: Records, mission: Mission, rows: Array) -> Errors:
    """The errors of a run.

    Args:
        filter_: That has run.
        states: (K,) its states.
        mission: Truth and biases.
        rows: (K,) rows of the mission at which the states are.
    """
    nav, truth = states["nav"], mission.truth
    invariant, n = filter_.vehicle.invariant, filter_.n
    psi = attitude_error(nav, truth.C_n_b[rows], invariant=invariant)
    P = filter_.covariance(states)
    v_b = np.einsum("kji,kj->ki", truth.C_n_b[rows], truth.v_n[rows])
    v_b -= np.einsum("kji,kj->ki", nav["C_n_b"], nav["v_n"])
    J = np.array(
        [
            body_velocity_jacobian(C, v, invariant=invariant, n=n)
            for C, v in zip(nav["C_n_b"], nav["v_n"], strict=True)
        ]
    )
    db = mission.bias[rows] - np.concatenate([nav["b_f"], nav["b_w"]], axis=1)
    heading = ATTITUDE.stop - 1
    sigma = np.sqrt(P[:, heading, heading])
    return Errors(
        attitude=squared(psi, P[:, ATTITUDE, ATTITUDE]) / 3.0,
        heading=(psi[:, 2] / sigma) ** 2,
        velocity=squared(v_b, J @ P @ np.swapaxes(J, 1, 2)) / 3.0,
        biases=squared(db, P[:, _BIASES, _BIASES]) / 6.0,
        heading_deg=np.degrees(psi[:, 2]),
        heading_sigma_deg=np.degrees(sigma),
    )


def squared(e: Array, P: Array) -> Array:
    """e^T P^-1 e of errors (K, m) and covariances (K, m, m)."""
    return np.asarray(np.einsum("ki,ki->k", e, np.linalg.solve(P, e[..., None])[..., 0]))
