"""Vibration of the vehicle: real motion, in velocity and attitude, faster than a filter's memory.

It is a sum of sines. Each has its own amplitudes and phases of the three velocities and the three
angles in body axes, and all grow with speed and rate of turn:

    m(t)    = (u / u_1)^2 + (psi' / w_1)^2
    v_b    += m V(t),   C_n_b <- C_n_b exp([m A(t) x])
    a_n    += C_n_b ((m V)' + w_nb_b x m V)
    w_nb_b <- exp(-[m A x]) w_nb_b + J (m A)',  J the mean of exp(-[s m A x]) over s from 0 to 1

The place moves by m times the integral of V, less than a millimetre; its own small changes, with m
and with the turn of the body, are left out.
"""

from dataclasses import dataclass

import numpy as np

from insdvl.arrays import Array
from insdvl.kernels import kernel
from insdvl.navigation.geometry.earth import radii
from insdvl.navigation.geometry.rotation import exponential, rotate_back
from insdvl.simulation.motion import Channel, Motion, Tables, channel_at

#: Speed [m/s] at which m is 1 in straight motion, and rate of turn [rad/s] which adds 1.
SPEED, TURN = 1.0, 0.15


@dataclass(frozen=True, eq=False)
class Vibration:
    """A sum of L sines.

    Attributes:
        omega: (L,) angular frequencies [rad/s].
        sine: (L, 6) amplitudes of the sines of the rates of change at m = 1: of the velocities
            [m/s^2], then of the angles [rad/s].
        cosine: (L, 6) those of the cosines.
    """

    omega: Array
    sine: Array
    cosine: Array

    def shake(self, t: Array, speed: Channel, heading: Channel, llh: Array, motion: Motion) -> None:
        """Add the vibration at times t (N,) to a motion.

        Args:
            t: [s].
            speed: Of the motion; with the heading it decides how strong the vibration is.
            heading: Of the motion.
            llh: (N, 3) latitude, longitude [rad] and height [m].
            motion: Attitude, velocity, acceleration and turn rate.
        """
        tables = speed.tables, heading.tables
        _shake(t, self.omega, self.sine, self.cosine, *tables, llh, *motion)


def drawn_sines(omega: Array, variances: Array, rng: np.random.Generator) -> Vibration:
    """Sines of random phases.

    Args:
        omega: (L,) angular frequencies [rad/s].
        variances: (L, 6) of the accelerations [(m/s^2)^2], then of the angular rates [(rad/s)^2].
        rng: Generator of the phases.
    """
    amplitude, phase = np.sqrt(2.0 * variances), rng.uniform(0.0, 2.0 * np.pi, variances.shape)
    return Vibration(omega, amplitude * np.sin(phase), amplitude * np.cos(phase))


@kernel
def _shake(
    t: Array,
    omega: Array,
    sine: Array,
    cosine: Array,
    speed: Tables,
    heading: Tables,
    llh: Array,
    C_n_b: Array,
    v_n: Array,
    a_n: Array,
    w_nb_b: Array,
) -> None:
    u, psi = np.empty(3), np.empty(3)
    value, rate, integral = np.empty(6), np.empty(6), np.empty(3)
    R, R_mean, C = np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3))
    w, change = np.empty(3), np.empty(3)
    for i in range(t.size):
        channel_at(t[i], speed[0], speed[1], speed[2], u)
        channel_at(t[i], heading[0], heading[1], heading[2], psi)
        m = (u[0] / SPEED) ** 2 + (psi[1] / TURN) ** 2
        m_rate = 2.0 * (u[0] * u[1] / SPEED**2 + psi[1] * psi[2] / TURN**2)
        value[:] = 0.0
        rate[:] = 0.0
        integral[:] = 0.0
        for k in range(omega.size):
            s, c = np.sin(omega[k] * t[i]), np.cos(omega[k] * t[i])
            for j in range(6):
                x = (cosine[k, j] * s - sine[k, j] * c) / omega[k]
                y = sine[k, j] * s + cosine[k, j] * c
                value[j] += x
                rate[j] += y
                if j < 3:
                    integral[j] -= y / omega[k] ** 2
        for j in range(6):
            rate[j] = m * rate[j] + m_rate * value[j]
            value[j] *= m

        C[:] = C_n_b[i]
        w[:] = w_nb_b[i]
        rate[0] += w[1] * value[2] - w[2] * value[1]
        rate[1] += w[2] * value[0] - w[0] * value[2]
        rate[2] += w[0] * value[1] - w[1] * value[0]
        for j in range(3):
            v_n[i, j] += C[j, 0] * value[0] + C[j, 1] * value[1] + C[j, 2] * value[2]
            a_n[i, j] += C[j, 0] * rate[0] + C[j, 1] * rate[1] + C[j, 2] * rate[2]
        R_N, R_E = radii(llh[i, 0])
        for j in range(3):
            move = m * integral[j]
            llh[i, 0] += C[0, j] * move / (R_N + llh[i, 2])
            llh[i, 1] += C[1, j] * move / ((R_E + llh[i, 2]) * np.cos(llh[i, 0]))
            llh[i, 2] -= C[2, j] * move

        exponential(R, R_mean, value[3], value[4], value[5])
        rotate_back(w_nb_b[i], R, w)
        rotate_back(change, R_mean, rate[3:])
        for j in range(3):
            w_nb_b[i, j] += change[j]
            for k in range(3):
                C_n_b[i, j, k] = C[j, 0] * R[0, k] + C[j, 1] * R[1, k] + C[j, 2] * R[2, k]
