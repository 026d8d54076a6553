"""What the innovations say of the filter's covariance."""

from scipy.special import gammaincinv


def nis_median(rows: int) -> float:
    """Median of the normalised innovation squared of a consistent filter.

    It is chi-square with as many degrees of freedom as the measurement has rows.
    """
    return 2.0 * float(gammaincinv(rows / 2.0, 0.5))
