"""Channels of the IMU that do not show the motion: saturated, frozen, or glitching.

The filter goes on with what it has, and its covariance knows what may have gone unseen. The rules
are derived in docs/explanation/filter.md.
"""

import math
from dataclasses import dataclass

import numpy as np

from insdvl.arrays import Array, Records, Stamps
from insdvl.kernels import kernel
from insdvl.navigation.geometry.rotation import rotate_back
from insdvl.navigation.prediction import strapdown
from insdvl.navigation.state.fields import NEVER, State
from insdvl.navigation.state.scratch import Constants, Workspace
from insdvl.parameters.declaration import lever_arm, mount, parameter, time_offset


@dataclass(frozen=True)
class ImuParameters:
    """The real IMU."""

    rate: float = parameter(
        100.0,
        "Nominal rate of the IMU; turns a variance per sample into a density.",
        unit="Hz",
        above=0.0,
        high=10_000.0,
    )
    mount: tuple[float, ...] = mount("IMU")
    lever_arm: tuple[float, ...] = lever_arm("IMU")
    time_offset: float = time_offset("IMU")
    frame_id: str = parameter(
        "", "A sample of any other frame_id is refused as 'wrong_frame'; empty for any."
    )
    max_gap: float = parameter(
        0.1,
        "An interval between IMU stamps longer than this is a gap: it is counted, bridged with "
        "the sample that ends it, and adds the uncertainty of the unseen motion.",
        unit="s",
        above=0.0,
    )
    gap_acceleration_std: float = parameter(
        0.5, "Unseen acceleration in a gap, one sigma.", unit="m/s^2", low=0.0
    )
    gap_rate_std: float = parameter(
        0.05, "Unseen angular rate in a gap, one sigma.", unit="rad/s", low=0.0
    )
    acceleration_range: float = parameter(
        160.0,
        "A channel whose reading is at least this in size is saturated: the uncertainty of the "
        "unseen motion is added as in a gap, with at least this sigma. 0 for none.",
        unit="m/s^2",
        low=0.0,
    )
    rate_range: float = parameter(
        35.0, "As acceleration_range, for the angular rate.", unit="rad/s", low=0.0
    )
    frozen_samples: int = parameter(
        100,
        "A channel with this many exactly equal samples in a row is frozen: its reading is "
        "replaced by gravity alone, or by no turn, and the uncertainty of the unseen motion is "
        "added as in a gap. 0 disables the check.",
        low=0,
        high=1_000_000,
    )


#: Verdicts on a channel of a sample.
GOOD, GLITCH, NO_DATA = range(3)
#: A reading leaves its neighbours by so many sigma of the change between two of them.
LEAVES = 8.0
#: Changes that the sigma is taken from: at least, and at most. One that leaves right behind another
#: weighs as one of the last number: a stream that has become noisier is believed after a few.
FEWEST_CHANGES, CHANGES, QUICK = 50, 100, 10


@kernel
def has_no_data(reading: Array) -> bool:
    """Whether the specific force is exactly zero, which gravity never is."""
    return reading[0] == 0.0 and reading[1] == 0.0 and reading[2] == 0.0


@kernel
def judge(s: State, c: Constants, sample_ns: int, reading: Array) -> None:
    """Whether the channels of a sample are believed; once for each sample.

    A reading that leaves those before it is a glitch, unless the next one is nearer to it than to
    those: then it is believed after all, and the next sample makes up for it. Either may be wrong,
    so the step is remembered for the gate.

    Args:
        s: State at the sample before, or inside the interval of this one.
        c: Constants of the filter.
        sample_ns: Stamp of the sample.
        reading: (6,) f, then w.
    """
    channels = s.channels
    if channels.verdict_ns == sample_ns:
        return
    channels.verdict_ns = sample_ns
    no_data = has_no_data(reading)
    follows = _follows(s, c, sample_ns)
    for i in range(6):
        channels.verdict[i], channels.amends[i] = GOOD, 0.0
        if no_data:
            channels.verdict[i] = NO_DATA
        elif follows and channels.changes >= FEWEST_CHANGES:
            change, agrees = _change(s, c, reading, i)
            if change > _limit(s, c, i):
                channels.verdict[i] = GLITCH
                _remember_step(s, i, sample_ns, change)
            elif agrees:
                channels.amends[i] = channels.left_out[i] / ((sample_ns - channels.imu_ns) * 1e-9)
                _remember_step(s, i, sample_ns, 0.0)
        if channels.verdict[i] != GOOD and channels.changes > 0:
            channels.amends[i] = channels.believed[i] - reading[i]


@kernel
def _remember_step(s: State, i: int, sample_ns: int, size: float) -> None:
    """Size of the largest step of a channel since velocity was last told, first and last stamp."""
    channels = s.channels
    if channels.step_ns[i] <= channels.told_ns:
        channels.step[i], channels.step_from_ns[i] = 0.0, channels.imu_ns
    channels.step[i], channels.step_ns[i] = max(channels.step[i], size), sample_ns


@kernel
def _follows(s: State, c: Constants, sample_ns: int) -> bool:
    """Whether a sample has a neighbour before it."""
    channels = s.channels
    return channels.changes > 0 and 0 < sample_ns - channels.imu_ns <= c.gap_ns


@kernel
def _limit(s: State, c: Constants, i: int) -> float:
    """Largest change of a channel that is no glitch; in one sample a gap's sigma does no harm."""
    return max(LEAVES * np.sqrt(s.channels.change[i]), c.gap_f if i < 3 else c.gap_w)


@kernel
def _change(s: State, c: Constants, reading: Array, i: int) -> tuple[float, bool]:
    """Change of a channel, from what is believed or from the glitch before if that is nearer.

    Beyond its range it has nothing to agree with.
    """
    channels = s.channels
    change = abs(reading[i] - channels.believed[i])
    if channels.left_out[i] != 0.0 and not is_saturated(c, reading, i):
        again = abs(reading[i] - channels.reading[i])
        if again < change:
            return again, True
    return change, False


@kernel
def _learn(s: State, c: Constants, sample_ns: int, reading: Array) -> None:
    """How far apart neighbours are, from a sample that is complete."""
    channels, follows = s.channels, _follows(s, c, sample_ns)
    if has_no_data(reading):
        channels.left_out[:] = 0.0
        return
    for i in range(6):
        change, _ = _change(s, c, reading, i)
        memory, saturated = min(channels.changes, CHANGES), is_saturated(c, reading, i)
        again = channels.left_out[i] != 0.0
        if channels.verdict[i] == GLITCH:
            seconds = (sample_ns - channels.imu_ns) * 1e-9
            left_out = (reading[i] - channels.believed[i]) * seconds
            channels.left_out[i] = 0.0 if saturated else left_out
            if not again:
                continue  # a single one tells nothing of the others
            change, memory = _limit(s, c, i), QUICK
        else:
            channels.believed[i], channels.left_out[i] = reading[i], 0.0
        if follows and not saturated:
            channels.change[i] += (change**2 - channels.change[i]) / memory
    if follows or channels.changes == 0:
        channels.changes += 1


@kernel
def is_saturated(c: Constants, reading: Array, i: int) -> bool:
    """Whether a channel reads its range or more."""
    return abs(reading[i]) >= c.range[i]


@kernel
def is_frozen(s: State, c: Constants, reading: Array, i: int) -> bool:
    """Whether the sample is at least the last of ``frozen_samples`` that are equal."""
    channels = s.channels
    return 0 < c.frozen <= channels.equal[i] + 1 and reading[i] == channels.reading[i]


@kernel
def unseen_sigma(c: Constants, reading: Array, i: int) -> float:
    """One sigma of the motion that a channel in doubt does not see [m/s^2 or rad/s].

    A channel that is saturated may be stuck there: its range at least.
    """
    sigma = c.gap_f if i < 3 else c.gap_w
    if is_saturated(c, reading, i):
        return max(sigma, c.range[i])
    return sigma


@kernel
def _growth(from_ns: int, to_ns: int, since_ns: int, is_new: bool) -> float:
    """Density over a step that makes T^2 grow, T being the time since a stamp; or all of it."""
    before = 0.0 if is_new else (from_ns - since_ns) * 1e-9
    after = (to_ns - since_ns) * 1e-9
    return (after**2 - before**2) / ((to_ns - from_ns) * 1e-9)


@kernel
def doubt(s: State, w: Workspace, c: Constants, reading: Array, to_ns: int, told_ns: int) -> bool:
    """Densities, up to a stamp, of the motion that channels do not see; whether there is any.

    As in a gap, a constant error of one sigma over a time T makes (sigma T)^2. T starts with the
    sample that saturates or is not believed, or with the first of those that are equal: what grew
    until that was noticed is added at once. An accepted velocity measurement tells velocity and
    tilt, so for them T starts again with it; it does not tell the heading.

    Args:
        reading: (6,) sample, as the IMU has read it, in its axes: f, then w.
        to_ns: End of the step.
        told_ns: Stamp of the last accepted velocity measurement.
    """
    channels, time_ns = s.channels, s.nav.time_ns
    any_unseen = False
    for i in range(6):
        w.unseen[i] = w.unseen_heading[i] = 0.0
        frozen = is_frozen(s, c, reading, i)
        w.frozen[i] = frozen or (channels.verdict[i] == NO_DATA and channels.changes == 0)
        if not (frozen or is_saturated(c, reading, i) or channels.verdict[i] != GOOD):
            continue
        sigma = unseen_sigma(c, reading, i)
        any_unseen = True
        is_new = channels.unseen_ns[i] == NEVER
        if is_new:
            channels.unseen_ns[i] = channels.equal_ns[i] if frozen else channels.imu_ns
        since_ns = max(channels.unseen_ns[i], told_ns)
        w.unseen[i] = _growth(time_ns, to_ns, since_ns, is_new)
        if i >= 3:
            total = _growth(time_ns, to_ns, channels.unseen_ns[i], is_new)
            w.unseen_heading[i] = sigma**2 * (total - w.unseen[i])
        w.unseen[i] *= sigma**2
    return any_unseen


@kernel
def replace_frozen(s: State, w: Workspace, c: Constants) -> None:
    """Put what is expected without acceleration and turn in the place of frozen channels.

    The attitude tells the share of gravity, which may be far more than the motion.
    """
    strapdown.earth_terms(s, w, c, 0.0)
    rotate_back(w.g_b, s.nav.C_n_b, w.g_n)
    for i in range(3):
        force, rate = 0.0, 0.0
        for a in range(3):
            force += c.C_b_i[a, i] * (-w.g_b[a] - w.f_hat[a])
            rate -= c.C_b_i[a, i] * w.w_hat[a]
        for a in range(3):
            if w.frozen[i]:
                w.f_hat[a] += c.C_b_i[a, i] * force
            if w.frozen[3 + i]:
                w.w_hat[a] += c.C_b_i[a, i] * rate


@kernel
def make_amends(s: State, w: Workspace, c: Constants) -> None:
    """Put what is believed in the place of what the channels of the sample have read."""
    amends = s.channels.amends
    for i in range(3):
        for a in range(3):
            w.f_hat[a] += c.C_b_i[a, i] * amends[i]
            w.w_hat[a] += c.C_b_i[a, i] * amends[3 + i]


@kernel
def add_unseen(s: State, w: Workspace, c: Constants) -> None:
    """Add the densities of the motion that is not seen to those of the input noise."""
    _add_rotated(w.S_f, c.C_b_i, w.unseen, 0)
    _add_rotated(w.S_w, c.C_b_i, w.unseen, 3)
    _add_vertical(w.S_w, s.nav.C_n_b, c.C_b_i, w.unseen_heading)


@kernel
def _add_rotated(Q: Array, C: Array, variances: Array, first: int) -> None:
    """Q += C diag(variances[first : first + 3]) C^T."""
    for i in range(3):
        for j in range(3):
            for a in range(3):
                Q[i, j] += C[i, a] * variances[first + a] * C[j, a]


@kernel
def _add_vertical(Q: Array, C_n_b: Array, C_b_i: Array, variances: Array) -> None:
    """Q += sum of variances[3 + k] (a_k . d)^2 d d^T, for the axes a_k and the vertical d."""
    for k in range(3):
        share = 0.0
        for a in range(3):
            share += C_b_i[a, k] * C_n_b[2, a]
        for i in range(3):
            for j in range(3):
                Q[i, j] += variances[3 + k] * share**2 * C_n_b[2, i] * C_n_b[2, j]


@kernel
def watch(s: State, c: Constants, sample_ns: int, reading: Array) -> None:
    """Remember what the channels read, and which of them are to be believed."""
    channels, counters = s.channels, s.counters
    judge(s, c, sample_ns, reading)
    _learn(s, c, sample_ns, reading)
    saturated, frozen, glitch = 0, 0, 0
    for i in range(6):
        if channels.verdict[i] == GLITCH:
            glitch = 1
        if is_saturated(c, reading, i):
            saturated = 1
        elif is_frozen(s, c, reading, i):
            frozen = 1
        elif channels.verdict[i] == GOOD:
            channels.unseen_ns[i] = NEVER
        if channels.equal[i] > 0 and reading[i] == channels.reading[i]:
            channels.equal[i] += 1
        else:
            channels.equal[i] = 1
            channels.equal_ns[i] = sample_ns
            channels.reading[i] = reading[i]
    counters.saturated += saturated
    counters.frozen += frozen
    counters.glitches += glitch
    counters.no_data += channels.verdict[0] == NO_DATA


@kernel
def any_unseen(unseen_ns: Stamps) -> bool:
    """Whether a channel of the IMU is saturated, frozen or not believed, by ``unseen_ns`` (6,)."""
    count = 0
    for i in range(6):
        count += unseen_ns[i] != NEVER
    return count > 0


@kernel
def turn_noise(state: Records, constants: Records, share: Array, covariance: Array) -> bool:
    """Covariance (3, 3) of a rate whose variance is ``share`` (3,) times that of one sample.

    Returns:
        Whether a channel of the IMU is in doubt.
    """
    s, c = state[0], constants[0]
    for i in range(3):
        for j in range(3):
            of_sample = s.noise.Q_w[i, j] * (c.density * c.rate)
            covariance[i, j] = of_sample * math.sqrt(share[i] * share[j])
    return any_unseen(s.channels.unseen_ns)


def in_doubt(s: State) -> bool:
    """Whether a channel of the IMU is saturated, frozen or not believed."""
    return any_unseen(s["channels"]["unseen_ns"])


def seen_rate(s: State, c: Constants, w_ib_b: Array) -> tuple[Array, Array]:
    """The angular rate, and its variance, where channels of the gyroscope are in doubt.

    A frozen one is taken not to turn, one that is not believed to turn as before.

    Args:
        s: State.
        c: Constants of the filter.
        w_ib_b: (3,) angular rate [rad/s], base_link axes.

    Returns:
        (3,) rate and (3, 3) variance, base_link axes.
    """
    channels, C = s["channels"], c["C_b_i"]
    unseen = channels["unseen_ns"][3:] != NEVER
    frozen = unseen & (channels["equal"][3:] + 1 >= c["frozen"]) & (c["frozen"] > 0)
    sigma = unseen * [unseen_sigma(c, channels["reading"], i) for i in (3, 4, 5)]
    w = np.where(channels["verdict"][3:] == GOOD, C.T @ w_ib_b, channels["believed"][3:])
    w = np.where(frozen, C.T @ s["nav"]["b_w"], w)
    return C @ w, C @ np.diag(sigma**2) @ C.T
