"""What the innovations say of the filter's covariance."""

from insdvl.navigation.filter import UpdateReport
from insdvl.navigation.gate.chi_square import exceeded


def nis_median(rows: int) -> float:
    """Median of the normalised innovation squared of a consistent filter.

    It is chi-square with as many degrees of freedom as the measurement has rows.
    """
    return exceeded(rows, 0.5)


def scaled_nis(report: UpdateReport) -> float:
    """The NIS of a judged measurement, scaled to all rows where some of them were not measured."""
    return report.nis * (len(report.innovation) / report.rows)


def nis_interval(rows: int, count: int, probability: float) -> tuple[float, float]:
    """Where the mean NIS of a consistent filter lies with a probability, half beyond each end.

    Args:
        rows: Of each measurement.
        count: Number of independent measurements.
        probability: Between 0 and 1.
    """
    tail = (1.0 - probability) / 2.0
    return exceeded(rows * count, 1.0 - tail) / count, exceeded(rows * count, tail) / count
