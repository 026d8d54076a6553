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
