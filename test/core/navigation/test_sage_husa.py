"""Q and R by the recursions of Sage and Husa."""

import numpy as np
import pytest

from insdvl.studies.evaluation.approaches import Setting
from insdvl.studies.evaluation.metrics import rmse
from insdvl.studies.evaluation.monte_carlo import TUNING, Run, Study, track_of
from insdvl.timeline.output import FoldResult

TRUE = (0.01, 0.001)  # of the scenario `constant`


@pytest.fixture(scope="module")
def run() -> Run:
    return Run(Study("constant", seed=3), TUNING, 0)


def flown(
    run: Run,
    nominal: tuple[float, float],
    form: str = "",
    error_state: str = "",
    **bounds: float,
) -> FoldResult:
    source = {"source": "adaptive", "adaptive_form": form, "adaptive_forgetting": 0.99, **bounds}
    parameters = Setting("calibrated", error_state).filter(nominal, **(source if form else {}))
    return run.fold_received(parameters, np.empty(0, np.int64), np.empty((0, 6)))


def body_rmse(fold: FoldResult, run: Run) -> float:
    return rmse(track_of(fold).v_b - run.truth.v_b)


@pytest.mark.parametrize(("factor", "error_state"), [(0.01, "invariant"), (0.01, "ned"), (100, "")])
def test_a_wrong_nominal_q_is_mended(run: Run, factor: float, error_state: str) -> None:
    right = body_rmse(flown(run, TRUE, "", error_state), run)
    wrong = (factor * TRUE[0], factor * TRUE[1])
    constant = body_rmse(flown(run, wrong, "", error_state), run)
    adapted = body_rmse(flown(run, wrong, "sage_husa", error_state), run)
    assert constant > 1.3 * right
    assert adapted < 1.2 * right


def test_q_and_r_together_stay_covariances_within_their_bounds(run: Run) -> None:
    bounds = {
        "accelerometer_floor": 1e-3,
        "accelerometer_ceiling": 4e-3,
        "gyroscope_floor": 1e-6,
        "gyroscope_ceiling": 2e-5,
    }
    noise = flown(run, (1e-3, 1e-6), "sage_husa_r", **bounds).states["noise"]
    for name, triad in (("Q_f", "accelerometer"), ("Q_w", "gyroscope")):
        diagonal = np.diagonal(noise[name], axis1=1, axis2=2)
        low, high = bounds[f"{triad}_floor"], bounds[f"{triad}_ceiling"]
        assert diagonal.min() == pytest.approx(low) and diagonal.max() == pytest.approx(high)
    R = noise["innovations"][8:, 0]  # told is 0.01 (m/s)^2
    assert (R >= 0.999 * 0.01 * 0.01).all() and (R <= 1.001 * 100.0 * 0.01).all()
