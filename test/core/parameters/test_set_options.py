"""Parameters that a command line sets take precedence over files."""

from pathlib import Path

import pytest

from insdvl.navigation.parameters import FilterParameters
from insdvl.parameters.declaration import ParameterError
from insdvl.parameters.files import read
from insdvl.parameters.settings import load_set, settings
from insdvl.tuner.parameters import TunerParameters

GROUPS = {"insdvl_filter": FilterParameters, "insdvl_tuner": TunerParameters}


def test_a_setting_goes_to_the_node_that_knows_it() -> None:
    rules, faults = ["dvl.max_speed=3", "rate=2.0", "imu.rate=50.0", "imu.rate=200.0"], []
    found = settings(rules, GROUPS, faults)
    assert found["insdvl_filter"] == {"dvl.max_speed": 3, "imu.rate": 200.0}
    assert found["insdvl_tuner"] == {"rate": 2.0}
    named = settings(["insdvl_tuner:max_gap=0.5"], GROUPS, faults)
    assert named == {"insdvl_filter": {}, "insdvl_tuner": {"max_gap": 0.5}}
    lists = settings(["dvl.lever_arm=[1.0, 0.0, 0.5]", "gate.enabled = false"], GROUPS, faults)
    assert lists["insdvl_filter"]["dvl.lever_arm"] == [1.0, 0.0, 0.5]
    assert lists["insdvl_filter"]["gate.enabled"] is False
    assert not faults


@pytest.mark.parametrize(
    ("rule", "message"),
    [
        ("dvl.max_sped=3", "unknown parameter 'dvl.max_sped'; did you mean dvl.max_speed?"),
        ("insdvl_tuner:dvl.max_speed=3", "unknown parameter 'dvl.max_speed'"),
        ("tuner:rate=3", "the nodes are insdvl_filter, insdvl_tuner"),
        ("rate", "it must be NAME=VALUE"),
        ("=3", "it must be NAME=VALUE"),
        ("rate=[1, 2.5]", "Sequence should be of same type"),
        ("rate=", "it must be NAME:=VALUE"),
    ],
)
def test_a_wrong_setting_is_told(rule: str, message: str) -> None:
    faults: list[str] = []
    settings([rule, "imu.rate=50.0", rule], GROUPS, faults)
    assert len(faults) == 2
    assert all(fault.startswith(f"--set {rule}: ") and message in fault for fault in faults)


def test_it_takes_precedence_whatever_the_sections_and_types(tmp_path: Path) -> None:
    file = tmp_path / "vehicle.yaml"
    file.write_text(
        "/**: {ros__parameters: {dvl.max_speed: 4.0}}\n"
        "/**/insdvl_filter: {ros__parameters: {dvl: {max_speed: 5}, imu.rate: 50.0}}\n"
    )
    for value in (3.0, 3):
        told = {"dvl.max_speed": value}
        loaded = load_set(read([file]), "/insdvl_filter", FilterParameters, told)
        assert loaded.parameters.dvl.max_speed == 3.0
        assert loaded.parameters.imu.rate == 50.0
    with pytest.raises(ParameterError) as caught:
        load_set(read([file]), "/insdvl_filter", FilterParameters, {"imu.rate": -1.0})
    assert "vehicle.yaml" not in str(caught.value) and "imu.rate" in str(caught.value)
