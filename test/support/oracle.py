"""A dense filter in plain numpy and scipy: the same equations as insdvl, told in another way.

Nothing here is taken from insdvl. Rotations are scipy's, their means come from quadrature, and the
matrices of the invariant error from those of the plain one by the change of coordinates

    x_invariant = T x_ned,  T = I but for [v x] in the block (velocity, attitude) and
                            [x x] in the block (position, attitude), x being metres from the start,

so F = T F_ned T^-1 + T' T^-1, G = T G_ned, H = H_ned T^-1.
"""

from dataclasses import dataclass, field

import numpy as np
from scipy.linalg import expm
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

V, A, F, W, P, D = (slice(i, i + 3) for i in range(0, 18, 3))
I3 = np.eye(3)
NS = 10**9
A_WGS, F_WGS = 6378137.0, 1 / 298.257223563
E2 = F_WGS * (2 - F_WGS)

# Quadrature over [0, 1], exact to rounding for the mean of a rotation through a few degrees.
NODES, WEIGHTS = np.polynomial.legendre.leggauss(5)
NODES, WEIGHTS = (NODES + 1) / 2, WEIGHTS / 2


def skew(a):
    return np.array([[0.0, -a[2], a[1]], [a[2], 0.0, -a[0]], [-a[1], a[0], 0.0]])


def exp(phi):
    """exp([phi x]) of rotation vectors (..., 3)."""
    return Rotation.from_rotvec(phi).as_matrix()


def turned(phi):
    """exp([phi x]) and its mean over the turn, both from one matrix exponential."""
    block = np.zeros((6, 6))
    block[:3, :3], block[:3, 3:] = skew(phi), I3
    result = expm(block)
    return result[:3, :3], result[:3, 3:]


def wgs84(lat, h):
    """Gravity, Earth rate and the matrix of the transport rate, in NED."""
    a, f, rate, mu = 6378137.0, 1 / 298.257223563, 7.292115e-5, 3.986004418e14
    e2, sine2 = 2 * f - f * f, np.sin(lat) ** 2
    east = a / np.sqrt(1 - e2 * sine2)
    north = a * (1 - e2) / np.sqrt(1 - e2 * sine2) ** 3
    g_0 = 9.7803253359 * (1 + 0.00193185265241 * sine2) / np.sqrt(1 - e2 * sine2)
    m = rate**2 * a**3 * (1 - f) / mu
    g = g_0 * (1 - 2 * h / a * (1 + f * (1 - 2 * sine2) + m) + 3 * (h / a) ** 2)
    w_ie = rate * np.array([np.cos(lat), 0.0, -np.sin(lat)])
    W_v = np.zeros((3, 3))
    W_v[0, 1], W_v[1, 0], W_v[2, 1] = 1 / (east + h), -1 / (north + h), -np.tan(lat) / (east + h)
    return np.array([0.0, 0.0, g]), w_ie, W_v, north


def scales(lat, h):
    """Metres per radian of latitude and longitude, and per metre of height, to the down axis."""
    s = 1 - E2 * np.sin(lat) ** 2
    return np.array([A_WGS * (1 - E2) / s**1.5 + h, (A_WGS / s**0.5 + h) * np.cos(lat), -1.0])


def metres(start, end):
    """North, east, down between two places, by the scales halfway; longitudes do not wrap here."""
    return (end - start) * scales((start[0] + end[0]) / 2, (start[2] + end[2]) / 2)


def gone(start, d):
    """The place at the end of so many metres north, east, down: a root of `metres`."""
    guess = start + d / scales(start[0], start[2])
    for _ in range(6):
        guess = start + d / scales((start[0] + guess[0]) / 2, (start[2] + guess[2]) / 2)
    return guess


@dataclass
class DenseFilter:
    """Predict and update with everything written out.

    Frames are NED and forward-right-down; Q is in base_link axes, a density.
    """

    invariant: bool
    C: np.ndarray
    v: np.ndarray
    p: np.ndarray  # latitude, longitude, height
    r: np.ndarray  # the same of the start
    P: np.ndarray
    eps_f: float = 0.0
    eps_w: float = 0.0
    C_b_d: np.ndarray = field(default_factory=lambda: np.eye(3))
    l_b: np.ndarray = field(default_factory=lambda: np.zeros(3))
    dvl_std: np.ndarray = field(default_factory=lambda: np.zeros(3))  # of each axis
    dvl_time_constant: float = 1.0
    gate_probability: float = 1.0
    exact: bool = False  # Phi and Q_d from matrix exponentials, not of second order
    b_f: np.ndarray = field(default_factory=lambda: np.zeros(3))
    b_w: np.ndarray = field(default_factory=lambda: np.zeros(3))
    b_d: np.ndarray = field(default_factory=lambda: np.zeros(3))
    bend: np.ndarray = field(default_factory=lambda: np.zeros(2))
    seconds: float = 0.0  # since the start

    @property
    def n(self):
        return len(self.P)

    def earth(self, ahead=0.0):
        lat, _, h = self.p + ahead * self.v / (A_WGS, 1.0, -1.0)
        return wgs84(lat, h)[:3]

    def coordinates(self, v, x):
        """T: from plain errors to those of the model; x are metres from the start."""
        T = np.eye(self.n)
        if self.invariant:
            T[V, A] = skew(v)
            T[P, A] = skew(x)
        return T

    def predict(self, f_b, w_ib_b, dt, Q_f, Q_w, w_before=None, sample=0.0):
        """A step under constant specific force and turn rate; Q_f, Q_w are densities.

        With the rate of the sample before, and the length of the sample that the step is (a part)
        of, the rate of coning is added.
        """
        f_b, w_ib_b = f_b - self.b_f, w_ib_b - self.b_w
        if w_before is not None:
            w_ib_b = w_ib_b + np.cross(w_before - self.b_w, w_ib_b) * sample / 12
        g, w_ie, W_v = self.earth(dt / 2)
        start = w_ie + W_v @ self.v
        mean_turn = np.tensordot(WEIGHTS, exp(NODES[:, None] * w_ib_b * dt), 1)
        C_mid = exp(-start * dt / 2) @ self.C @ mean_turn
        f_n = C_mid @ f_b

        def acceleration(v):
            return f_n + g - np.cross(2 * w_ie + W_v @ v, v)

        v_mid = self.v + dt / 2 * acceleration(self.v)
        a = acceleration(v_mid)
        x_mid = metres(self.r, self.p) + dt / 2 * self.v
        self.p = gone(self.p, dt * self.v + dt**2 / 2 * a)
        self.v = self.v + dt * a
        self.C = exp(-(w_ie + W_v @ v_mid) * dt) @ self.C @ exp(w_ib_b * dt)
        beta = 1 / self.dvl_time_constant
        self.b_d = self.b_d * np.exp(-beta * dt)

        n = self.n
        dynamics, G, Q = np.zeros((n, n)), np.zeros((n, n)), np.zeros((n, n))
        w_en = W_v @ v_mid
        dynamics[V, V] = skew(v_mid) @ W_v - skew(2 * w_ie + w_en)
        dynamics[V, A] = -skew(f_n)
        dynamics[V, F] = -C_mid
        dynamics[A, V] = -W_v
        dynamics[A, A] = -skew(w_ie + w_en)
        if self.invariant:  # what a line has of the sine of the heading error
            missed = (1.0 - np.exp(-self.P[5, 5] / 2)) * w_ie[0]
            dynamics[A.start + 1, 5] -= missed
            dynamics[V, 5] += 2 * missed * skew(v_mid)[:, 1]  # Coriolis
        dynamics[A, W] = -C_mid
        dynamics[P, V] = I3
        G[V, V], G[A, A], G[F, F], G[W, W] = -C_mid, -C_mid, I3, I3
        Q[V, V], Q[A, A], Q[F, F], Q[W, W] = Q_f, Q_w, self.eps_f * I3, self.eps_w * I3
        T, T_dot = self.coordinates(v_mid, x_mid), np.zeros((n, n))
        if self.invariant:
            T_dot[V, A], T_dot[P, A] = skew(a), skew(v_mid)
        back = 2 * np.eye(n) - T  # T^-1, since (T - I)^2 = 0
        dynamics, G = T @ dynamics @ back + T_dot @ back, T @ G
        noise = G @ Q @ G.T
        if self.invariant:
            rest = np.zeros((n, n))
            rest[A, A] = self.rest_of_the_heading(w_ie[0], dt)
            noise += T @ rest @ T.T
        if self.exact:
            if n > 15:
                dynamics[D, D] = -beta * I3
                noise[D, D] = 2 * beta * np.diag(self.dvl_std**2)
            Phi, Q_d = van_loan(dynamics, noise, dt)
            self.P = Phi @ self.P @ Phi.T + Q_d
        else:
            Phi = np.eye(n) + dynamics * dt + dynamics @ dynamics * dt**2 / 2
            half = noise * dt / 2
            if n > 15:
                Phi[D, D] = np.exp(-beta * dt) * I3
            self.P = Phi @ (self.P + half) @ Phi.T + half
            if n > 15:
                self.P[D, D] += np.diag(self.dvl_std**2) * (1 - np.exp(-2 * beta * dt))

        if self.invariant:
            e_x = np.array([[0.0, -1.0], [1.0, 0.0]])  # [e_D x], horizontally
            horizontal = slice(P.start, P.start + 2)
            before = np.outer(self.bend, self.bend)
            P_pb = self.P[horizontal, W] @ C_mid[2]
            self.bend = self.bend + dt * np.sqrt(3.0) * e_x @ P_pb
            self.P[horizontal, horizontal] += np.outer(self.bend, self.bend) - before

    def rest_of_the_heading(self, rate, dt):
        """Density of what a line leaves of the Earth's rotation in the axes of the heading."""
        s = self.P[5, 5]
        moments = np.array(
            [
                1 - 2 * np.exp(-s / 2) + (1 + np.exp(-2 * s)) / 2,
                (1 - np.exp(-2 * s)) / 2 - s * np.exp(-s),
                0.0,
            ]
        )
        r = rate**2 * moments
        bias = np.trace(self.P[W, W]) / 3
        density = 2 * self.seconds * np.diag(r * r / (r + bias))
        self.seconds += dt
        return density

    def tilt_times_velocity(self):
        """Mean (3,) and covariance (3, 3) of t x dv."""
        keep = np.diag([1.0, 1.0, 0.0])
        tt, tv, vv = keep @ self.P[A, A] @ keep, keep @ self.P[A, V], self.P[V, V]
        e = np.array([skew(unit) for unit in I3]).transpose(1, 0, 2)  # the permutation symbol
        mean = np.einsum("ijk,jk", e, tv)
        moments = np.einsum("jm,kn->jkmn", tt, vv) + np.einsum("jn,mk->jkmn", tv, tv)
        return mean, np.einsum("ijk,lmn,jkmn", e, e, moments)

    def update(self, v_d, R, w_ib_b, Q_w_there):
        """Correct with a DVL velocity.

        Args:
            w_ib_b: (3,) measured turn rate.
            Q_w_there: (3, 3) its covariance.

        Returns:
            innovation, S, nis and whether the state was corrected.
        """
        _, w_ie, W_v = self.earth()
        C_d_n = self.C_b_d.T @ self.C.T
        l_x = self.C_b_d.T @ skew(self.l_b)
        w_in = w_ie + W_v @ self.v
        w_nb = w_ib_b - self.b_w - self.C.T @ w_in
        h = self.C_b_d.T @ (self.C.T @ self.v + np.cross(w_nb, self.l_b))
        H = np.zeros((3, self.n))
        H[:, V] = C_d_n
        H[:, A] = C_d_n @ skew(self.v) + l_x @ self.C.T @ skew(w_in)
        H[:, W] = l_x
        if self.n > 15:
            H[:, D] = I3
            h = h + self.b_d
        H = H @ (2 * np.eye(self.n) - self.coordinates(self.v, metres(self.r, self.p)))
        R = R + l_x @ Q_w_there @ l_x.T
        S = H @ self.P @ H.T + R
        nu = v_d - h
        nis = nu @ np.linalg.solve(S, nu)
        if nis > chi2.ppf(self.gate_probability, 3):
            return nu, S, nis, False
        left = nu
        if self.invariant:
            mean, product = self.tilt_times_velocity()
            if np.trace(H[:, V] @ product @ H[:, V].T) > 1e-3 * np.trace(R):
                self.P[V, V] += product
                left = nu + H[:, V] @ mean
            else:
                mean = None
        K = np.linalg.solve(H @ self.P @ H.T + R, H @ self.P).T
        keep = np.eye(self.n) - K @ H
        self.P = keep @ self.P @ keep.T + K @ R @ K.T
        x = K @ left
        if self.invariant and mean is not None:
            turn = np.eye(self.n)
            turn[V, V] = exp(np.array([x[3], x[4], 0.0]))
            x[V] = turn[V, V] @ (x[V] - mean)
            self.P = turn @ self.P @ turn.T
        if self.invariant:
            down = np.array([0.0, 0.0, 1.0])
            heading, tilt = exp(x[5] * down), exp(x[A] - x[5] * down)
            self.C = heading @ tilt @ self.C
            self.v = heading @ (tilt @ self.v + x[V])
            way = metres(self.r, self.p)
            self.p = gone(self.p, heading @ (tilt @ way + x[P]) - way)
            turn = np.eye(self.n)
            turn[V, V] = turn[A, A] = turn[P, P] = heading
            self.P, self.bend = turn @ self.P @ turn.T, heading[:2, :2] @ self.bend
        else:
            self.C = exp(x[A]) @ self.C
            self.v, self.p = self.v + x[V], gone(self.p, x[P])
        self.b_f, self.b_w = self.b_f + x[F], self.b_w + x[W]
        if self.n > 15:
            self.b_d = self.b_d + x[D]
        return nu, S, nis, True


def van_loan(dynamics, noise, dt):
    """Phi and Q_d of x' = F x + n over a step, without approximation."""
    n = len(dynamics)
    block = np.zeros((2 * n, 2 * n))
    block[:n, :n], block[:n, n:], block[n:, n:] = -dynamics, noise, dynamics.T
    result = expm(block * dt)
    Phi = result[n:, n:].T
    return Phi, Phi @ result[:n, n:]


def rate_at(stamps_ns, samples, end_ns, length_ns, variance):
    """A line through the samples of a window, at its end, and the variance of its error.

    Each sample is constant over the interval before its stamp and stands for its middle. The slope
    is zero +- 0.1 rad/s^2 before they are seen, which is one more equation.

    Args:
        variance: (3,) of one sample.

    Returns:
        The rate (3,), and the variance (3,) of its error in units of that of one sample.
    """
    begins, ends = (stamps_ns[:-1] - end_ns) / NS, (stamps_ns[1:] - end_ns) / NS
    shares = np.minimum(ends, 0.0) - np.maximum(begins, -length_ns / NS)
    inside = shares > 0.0
    w, t, m = samples[1:][inside], (begins + ends)[inside] / 2, inside.sum()
    root = np.sqrt(shares[inside])
    rates, errors = np.empty(3), np.empty(3)
    for i, q in enumerate(variance):
        design = np.vstack([root[:, None] * np.column_stack([np.ones(m), t]), np.zeros(2)])
        design[m, 1] = np.sqrt(shares[inside].mean() * q) / 0.1
        weights = np.linalg.pinv(design)[0, :m] * root
        rates[i] = weights @ w[:, i]
        errors[i] = weights @ weights + (0.1 * (weights @ t)) ** 2 / q
    return rates, errors


def run(dense, stamps_ns, f_b, w_ib_b, events, window_ns, density, rate):
    """Fold a mission: events are (stamp, "Q", Q_f, Q_w) or (stamp, "dvl", v_d, R), sorted by stamp.

    The first event sets Q. Samples and Q are in base_link axes; Q is per sample as told.

    Returns:
        Copies of (C, v, p, b_f, b_w, b_d, P) at the stamps, and the reports of the updates.
    """
    states, reports = [], []
    time_ns, pending = stamps_ns[0], list(events)

    def apply_until(limit_ns, k):
        nonlocal time_ns, Q_f, Q_w
        while pending and pending[0][0] <= limit_ns:
            stamp, kind, first, second = pending.pop(0)
            step(stamp, k)
            if kind == "Q":
                Q_f, Q_w = first, second
            else:
                Q = Q_w * density * rate
                w, errors = rate_at(stamps_ns, w_ib_b, stamp, window_ns, np.diag(Q))
                Q = Q * np.sqrt(np.outer(errors, errors))
                reports.append(dense.update(first, second, w, Q))

    def step(to_ns, k):
        nonlocal time_ns
        if to_ns > time_ns:
            dt = (to_ns - time_ns) / NS
            before = (w_ib_b[k - 1], (stamps_ns[k] - stamps_ns[k - 1]) / NS) if k else ()
            dense.predict(f_b[k], w_ib_b[k], dt, Q_f * density, Q_w * density, *before)
            time_ns = to_ns

    Q_f = Q_w = None
    for k, stamp in enumerate(stamps_ns):
        apply_until(stamp - 1, k)
        step(stamp, k)
        apply_until(stamp, k)
        states.append(
            [
                x.copy()
                for x in (dense.C, dense.v, dense.p, dense.b_f, dense.b_w, dense.b_d, dense.P)
            ]
        )
    return states, reports
