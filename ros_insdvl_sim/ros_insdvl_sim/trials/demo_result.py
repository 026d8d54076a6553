"""The demo's result: both filters against the truth, printed and drawn."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from insdvl.arrays import Array
from insdvl.navigation.events import NS
from insdvl.navigation.geometry.frames import rotation_from_quaternion
from insdvl.studies.evaluation.metrics import Scores, Track, scores
from insdvl.studies.report import plots
from ros_insdvl.monitor import Monitor
from ros_insdvl.odometry_series import OdometrySeries
from ros_insdvl_sim.trials.demo_graph import FILTERS, Count
from ros_insdvl_sim.trials.environment import TrialError


def track_of(rows: Array) -> Track:
    """The states of an odometry series."""
    return Track(
        C_n_b=rotation_from_quaternion(rows[:, OdometrySeries.QUATERNION]),
        v_b=rows[:, OdometrySeries.VELOCITY],
        p_o=rows[:, OdometrySeries.POSITION],
    )


@dataclass(frozen=True)
class Outcome:
    """Truth and results at the stamps that the truth and both filters share.

    Attributes:
        t: (N,) time from the start of the mission [s].
        truth: (N,).
        results: Per filter.
        noises: True and learned process noise.
        scores: Per filter.
    """

    t: Array
    truth: Track
    results: list[plots.Result]
    noises: list[plots.Noise]
    scores: dict[str, Scores]


def evaluate(monitor: Monitor) -> Outcome:
    """Score both filters over all IMU stamps, from the time when both are initialised.

    Raises:
        TrialError: There is nothing to score.
    """
    true_stamps, true_rows = monitor.truth.arrays()
    series = {w.label.strip("/"): w.series.arrays() for w in monitor.filters}
    stamps = true_stamps
    for filter_stamps, _ in series.values():
        stamps = np.intersect1d(stamps, filter_stamps)
    if stamps.size < 2:
        raise TrialError("no stamps in common between the truth and the filters")
    start_ns = int(true_stamps[0])
    truth = track_of(true_rows[np.searchsorted(true_stamps, stamps)])
    shown = {w.label.strip("/"): w.shown(None, None) for w in monitor.filters}
    nis = {label: "-" if s.nis is None else f"{s.nis:.2f}" for label, s in shown.items()}
    results, scored = [], {}
    for label, (filter_stamps, rows) in series.items():
        rows = rows[np.searchsorted(filter_stamps, stamps)]
        track = track_of(rows)
        sigma = np.sqrt(rows[:, OdometrySeries.VELOCITY_VARIANCE])
        results.append(plots.Result(f"{label}, NIS {nis[label]}", track, sigma))
        scored[label] = scores(track, truth)
    noises = [
        plots.Noise(
            label,
            np.array([(noise.stamp_ns - start_ns) / NS for noise in kept]),
            np.array([noise.variances for noise in kept]).reshape(-1, 6),
        )
        for label, kept in (("true", monitor.true_q), ("learned", monitor.learned_q))
    ]
    return Outcome((stamps - start_ns) / NS, truth, results, noises, scored)


def print_counts(counts: list[Count]) -> None:
    """Print what was sent and received."""
    print(f"\n{'messages':18}{'topic':30}{'sent':>8}{'received':>10}")
    for c in counts:
        lost = "" if c.sent == c.received else "   DIFFER"
        print(f"{c.consumer:18}{c.topic:30}{c.sent:>8}{c.received:>10}{lost}")


def print_scores(scored: Mapping[str, Scores]) -> None:
    """Print the scores, body velocity first, and which filter was better."""
    names = {
        "body_velocity_rmse": "body velocity RMSE [m/s]",
        "srmse": "SRMSE [m/s]",
        "smae": "SMAE [m/s]",
        "heading_rmse_deg": "heading RMSE [deg]",
        "tilt_rmse_deg": "tilt RMSE [deg]",
        "position_rmse_horizontal": "position RMSE, horizontal [m]",
        "position_drift_percent": "position drift [% of distance]",
    }
    print(f"\n{'error against the truth':34}" + "".join(f"{name:>12}" for name in scored))
    for key, text in names.items():
        print(f"{text:34}" + "".join(f"{getattr(s, key):12.4f}" for s in scored.values()))
    print(f"\n{gain(scored)}")


def gain(scored: Mapping[str, Scores]) -> str:
    """What the learned process noise gains, in a sentence."""
    constant, learned = (scored[name.strip("/")].body_velocity_rmse for name in FILTERS)
    change = 100.0 * (learned / constant - 1.0)
    verdict = "better" if change < 0.0 else "WORSE"
    return (
        f"In body velocity the learned process noise is {abs(change):.1f} % {verdict} than the "
        f"constant one in this run: {learned:.3f} against {constant:.3f} m/s RMSE."
    )
