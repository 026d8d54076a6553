"""Layouts of other tools name topics and fields that our nodes publish."""

import json
import re
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterator
from typing import Any

import yaml
from sources import ROOT

from insdvl.messages import convert
from insdvl.messages.topics import (
    GLOBAL_POSITION,
    ODOMETRY,
    PROCESS_NOISE,
    TRUTH,
)
from insdvl.navigation.parameters import FilterParameters
from ros_insdvl.conversions import new_message
from ros_insdvl.filter import HELP

LAYOUTS = ROOT / "ros_insdvl" / "layouts"
#: What the nodes publish, beside /diagnostics.
TYPES = {
    f"/{ODOMETRY}": convert.ODOMETRY,
    f"/{TRUTH}": convert.ODOMETRY,
    f"/{PROCESS_NOISE}": convert.IMU,
    f"/{GLOBAL_POSITION}": convert.FIX,
    "/imu/bias": convert.IMU,
    "/dvl/innovation": convert.TWIST_WITH_COVARIANCE,
}
#: PlotJuggler computes these from a quaternion.
ANGLES = ("roll", "pitch", "yaw")


def number_at(topic: str, path: str) -> float:
    """The number that a path of fields and indices leads to, in a message of a topic."""
    value = new_message(TYPES[topic])
    for name, index in re.findall(r"(\w+)|\[(\d+)\]", path):
        value = getattr(value, name) if name else value[int(index)]
    return float(value)


def texts(value: Any) -> Iterator[str]:
    """All texts in a document, keys too."""
    if isinstance(value, str):
        yield value
    elif isinstance(value, dict):
        for key, item in value.items():
            yield from texts(key)
            yield from texts(item)
    elif isinstance(value, list):
        for item in value:
            yield from texts(item)


def topic_of(text: str) -> str:
    """The topic that a text begins with."""
    (topic,) = [name for name in TYPES if text == name or text.startswith((f"{name}.", f"{name}/"))]
    return topic


def test_the_filter_publishes_them() -> None:
    for topic in TYPES.keys() - {f"/{TRUTH}", f"/{PROCESS_NOISE}"}:
        assert topic.lstrip("/") in HELP.about


def test_foxglove() -> None:
    document = json.loads((LAYOUTS / "foxglove.json").read_text())
    named = [text for text in texts(document["configById"]) if text.startswith("/")]
    named.remove("/diagnostics")
    assert {topic_of(text) for text in named} == TYPES.keys()
    for text in named:
        topic = topic_of(text)
        if text != topic:
            assert number_at(topic, text.removeprefix(topic)) == 0.0
    panels = {text for text in texts(document["layout"]) if "!" in text}
    assert panels == document["configById"].keys()


def test_plotjuggler() -> None:
    root = ElementTree.parse(LAYOUTS / "plotjuggler.xml").getroot()
    curves = [curve.attrib["name"] for curve in root.iter("curve")]
    assert len(curves) == len(set(curves)) == 18
    for text in curves:
        topic = topic_of(text)
        path = text.removeprefix(topic).replace("/", ".")
        if path.rpartition(".")[2] in ANGLES:
            path = path.rpartition(".")[0] + ".w"
        number_at(topic, path)


def test_rviz() -> None:
    manager = yaml.safe_load((LAYOUTS / "insdvl.rviz").read_text())["Visualization Manager"]
    topics = [d["Topic"]["Value"] for d in manager["Displays"] if "Topic" in d]
    assert [TYPES[topic] for topic in topics] == [convert.ODOMETRY] * 2
    parameters = FilterParameters()
    assert manager["Global Options"]["Fixed Frame"] == parameters.odom_frame
    assert manager["Views"]["Current"]["Target Frame"] == parameters.base_frame
