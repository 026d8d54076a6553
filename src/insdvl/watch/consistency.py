"""What the innovations say of the filter's covariance."""

from scipy.special import gammaincinv

from insdvl.navigation.filter import UpdateReport


def nis_median(rows: int) -> float:
    """Median of the normalised innovation squared of a consistent filter.

    It is chi-square with as many degrees of freedom as the measurement has rows.
    """
    return 2.0 * float(gammaincinv(rows / 2.0, 0.5))


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
    half, tail = rows * count / 2.0, (1.0 - probability) / 2.0
    low, high = (2.0 * float(gammaincinv(half, p)) / count for p in (tail, 1.0 - tail))
    return low, high
