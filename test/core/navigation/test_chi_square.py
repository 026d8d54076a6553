"""The quantiles of chi-square are those of scipy."""

import pytest
from scipy.stats import chi2

from insdvl.navigation.gate.chi_square import exceeded


@pytest.mark.parametrize("dof", [1, 2, 3, 6, 15, 300, 3001])
@pytest.mark.parametrize("tail", [1e-9, 1e-3, 0.05, 0.5, 0.95])
def test_the_quantiles_are_those_of_scipy(dof: int, tail: float) -> None:
    """Also where exp(-x / 2) is zero, and where the bound is far from the mean."""
    assert exceeded(dof, tail) == pytest.approx(float(chi2.isf(tail, dof)), rel=1e-10)
