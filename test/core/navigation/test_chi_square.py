"""Quantiles of the chi-square distribution, against scipy's."""

import pytest
from scipy.special import gammainccinv

from insdvl.navigation.gate.chi_square import exceeded


@pytest.mark.parametrize("dof", [1, 2, 3, 4, 6, 7, 30, 1500, 60000])
@pytest.mark.parametrize("tail", [1e-9, 1e-4, 0.001, 0.05, 0.5, 0.9])
def test_the_value_is_that_of_the_inverse_function(dof: int, tail: float) -> None:
    assert exceeded(dof, tail) == pytest.approx(2.0 * gammainccinv(dof / 2.0, tail), rel=1e-12)
