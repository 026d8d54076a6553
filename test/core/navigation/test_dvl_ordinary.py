"""An ordinary DVL measurement, which one kernel takes in, does what every measurement does."""

from typing import Any

import numpy as np
import pytest
from support.steps import step_by_step

from insdvl.navigation.events import NS, Initial
from insdvl.navigation.filter import LAYOUT
from insdvl.navigation.measurements.dvl import Dvl, DvlModel
from insdvl.navigation.parameters import FilterParameters
from insdvl.navigation.state.fields import COUNT, STAMP
from insdvl.navigation.state.layout import part
from insdvl.parameters.declaration import build
from insdvl.simulation.mission import Mission, simulate
from insdvl.simulation.noise import constant
from insdvl.simulation.sensors.dvl import DvlModel as Sensor
from insdvl.simulation.trajectories import AUV
from insdvl.timeline.output import FoldResult
from insdvl.timeline.recorded import fold_arrays

SEED = 57_721
#: Of the state, in its own units: one product of 3 x 3 is summed in another order.
EQUAL = 1e-9
FILTERS: dict[str, dict[str, Any]] = {
    "invariant": {},
    "ned": {"error_state": "ned"},
    "all optional states": {
        "dvl.bias_model": "gauss_markov",
        "dvl.mount_std": [0.02] * 3,
    },
    "mounted": {"dvl.mount": [0.1, -0.05, 0.7], "dvl.lever_arm": [1.0, 0.2, -0.5]},
    "no gate": {"gate.enabled": False},
    "large corrections": {"initial.tilt_std": 0.3, "initial.velocity_std": 5.0},
}


def mission() -> Mission:
    variances = np.array([1e-4] * 3 + [1e-8] * 3)
    return simulate(
        AUV, constant(variances), seed=SEED, duration=90.0, dvl=Sensor(noise_std=(0.02,) * 3)
    )


def difficult(m: Mission) -> list[Dvl]:
    """Pings with an outage, single outliers, a component that is missing, and a bias that stays."""
    pings = []
    for stamp, v_d in zip(m.dvl_stamps_ns.tolist(), m.v_d, strict=True):
        second, measured = stamp // NS, (True, True, True)
        if 20 < second <= 45:
            continue
        if second in (10, 55):
            v_d = v_d + np.array([3.0, -2.0, 1.0])
        if second == 12:
            measured = (True, False, True)
        if second > 80:
            v_d = v_d + np.array([0.3, 0.0, 0.0])
        pings.append(Dvl(stamp, np.where(measured, v_d, 0.0), measured=measured))
    return pings


def fly(settings: dict[str, Any]) -> FoldResult:
    m = mission()
    parameters = build(FilterParameters, {"frame_convention": "ned"} | settings)
    truth = m.initial
    C = truth.C_n_b[0]
    start = Initial(m.start_ns, C, truth.p_o[0], C.T @ truth.v_n[0], "body")
    return fold_arrays(parameters, m.stamps_ns, m.f_b, m.w_ib_b, [start, *difficult(m)])


@pytest.mark.parametrize("settings", FILTERS.values(), ids=FILTERS)
def test_one_kernel_and_the_steps_that_all_measurements_take_agree(
    settings: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    taken, take_in = [], DvlModel.take_in

    def counted(*arguments: Any) -> Any:
        taken.append(take_in(*arguments))
        return taken[-1]

    with monkeypatch.context() as patch:
        patch.setattr(DvlModel, "take_in", counted)
        quick = fly(settings)
    step_by_step(monkeypatch)
    slow = fly(settings)
    assert sum(found is not None for found in taken) >= 40
    for a, b in zip(quick.updates, slow.updates, strict=True):
        assert (a.report.accepted, a.report.reason) == (b.report.accepted, b.report.reason)
        np.testing.assert_allclose(a.report.innovation, b.report.innovation, atol=1e-10)
        np.testing.assert_allclose(a.report.S, b.report.S, rtol=1e-8)
        np.testing.assert_allclose(a.report.nis, b.report.nis, rtol=1e-8, atol=1e-8)
    for path, field in LAYOUT.fields():
        x, y = part(quick.states, path)[field.name], part(slow.states, path)[field.name]
        if field.holds in (STAMP, COUNT):
            np.testing.assert_array_equal(x, y, err_msg=field.name)
        else:
            scale = np.nanmax(np.abs(y), initial=1e-30)
            np.testing.assert_allclose(x / scale, y / scale, atol=EQUAL, err_msg=field.name)
