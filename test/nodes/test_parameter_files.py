"""`insdvl replay` takes from parameter files what a node takes: rcl is the truth."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from rclpy.context import Context
from rclpy.node import Node
from rclpy.parameter import Parameter

from insdvl.navigation.parameters import FilterParameters
from insdvl.parameters.declaration import ParameterError
from insdvl.parameters.files import argument, effective, read
from insdvl.tuner.parameters import TunerParameters
from ros_insdvl.node import InsdvlNode

ALL, OWN = "/**: {ros__parameters: ", "/**/insdvl_filter: {ros__parameters: "

#: Texts of values. Each is in a section of its own line, so that any of them may be refused.
VALUES = (
    *("1e-9", "2e2", "3_600.0", "1_000", "~", "null", "1", "-1", "+1", "1.", ".5", "+.5e1", "-0"),
    *("yes", "no", "on", "off", "y", "n", "Y", "True", "TRUE", "tRUE", "true", "false"),
    *("0x1F", "0X1f", "0x", "010", "08", "0o17", "0b101", "1e999", "1e-310", "1e-400", "0e-400"),
    *("9223372036854775807", "9223372036854775808", "-9223372036854775809", "9" * 400),
    *("nan", ".nan", ".NaN", "-.nan", "inf", ".inf", "-.inf", "+.Inf", "infinity", "INF", "nano"),
    *("0x1p3", "0x1.8p3", "0x1p-2000", "1.0e+3", "1e+", "2001-01-01", "=", "<<", "a b", "1 2"),
    *("'5'", '"5"', "!!str 5", "!!float 5", "!!int '5'", "''", "'  5'", "&anchor 1.0", "*alias"),
    *("[1, 2]", "[1.0, 2]", "[1, 2.5]", "[true, 1]", "[a, 1]", "['1', 2]", "[y, n]", "[]"),
    *("{a: 1.0, b: {c: 2.0}}", "{}", "", "|\n      5", ">-\n      5", "a\n      b", "{a: }"),
)

#: Files, and the full name of the node.
FILES: dict[str, tuple[str, ...]] = {
    "shared then own": (ALL + "{x: 1.0}}", OWN + "{x: 2.0}}"),
    "own then shared": (OWN + "{x: 2.0}}", ALL + "{x: 1.0}}"),
    "in one file": (ALL + "{x: 1.0}}\n" + OWN + "{x: 2.0}}",),
    "the first appearance counts": (ALL + "{x: 1.0}}\n" + OWN + "{x: 2.0}}", ALL + "{x: 3.0}}"),
    "nested and dotted": (OWN + "{a: {b: {c: 1.0, d: 2.0}, e: 3.0}, a.f: 4.0}}",),
    "dotted over nested": (OWN + "{a: {x: 1.0}}}", OWN + "{a: {x: 2.0}}}", OWN + "{a.x: 3.0}}"),
    "nested over dotted": (OWN + "{a: {x: 1.0}}}", OWN + "{a.x: 3.0}}", OWN + "{a: {x: 2.0}}}"),
    "integer, then number": (OWN + "{x: 1}}", OWN + "{x: 2.5}}"),
    "number, then integer": (OWN + "{x: 2.5}}", OWN + "{x: 1}}"),
    "number, then text": (OWN + "{x: 2.5}}", OWN + "{x: a}}"),
    "list, then none": (OWN + "{x: [1.0]}}", OWN + "{x: []}}"),
    "number, then list": (OWN + "{x: 2.5}}", OWN + "{x: [1.0, 2.0]}}"),
    "twice": (ALL + "{x: 1.0}}\n" + ALL + "{y: 2.0}}",),
    "without slash": (
        "insdvl_filter: {ros__parameters: {x: 1.0}}\n"
        + ALL
        + "{x: 2.0}}\n/insdvl_filter: {ros__parameters: {x: 3.0}}",
    ),
    "any name": ("/*: {ros__parameters: {x: 1.0}}",),
    "any name below": ("/*/insdvl_filter: {ros__parameters: {x: 1.0}}",),
    "any below": ("/auv/**: {ros__parameters: {x: 1.0}}",),
    "namespace": ("/auv/insdvl_filter: {ros__parameters: {x: 1.0}}",),
    "nested names": ("auv: {insdvl_filter: {ros__parameters: {x: 1.0}}}",),
    "nested names with slash": ("/auv/:\n  insdvl_filter: {ros__parameters: {x: 1.0}}",),
    "nested under any": ("/**: {insdvl_filter: {ros__parameters: {x: 1.0}}}",),
    "two of one namespace": (
        "/auv:\n  insdvl_filter: {ros__parameters: {x: 1.0}}\n  b: {ros__parameters: {y: 1.0}}",
    ),
    "not a name": ("/auv-1/insdvl_filter: {ros__parameters: {x: 1.0}}",),
    "not a wildcard": ("/**x: {ros__parameters: {x: 1.0}}",),
    "empty name": ("//insdvl_filter: {ros__parameters: {x: 1.0}}",),
    "nothing": ("",),
    "comment": ("# nothing\n",),
    "list": ("- 1\n",),
    "section of a value": ("/**/insdvl_filter: 5",),
    "section of nothing": ("/**/insdvl_filter:",),
    "section without parameters": ("/**/insdvl_filter: {}",),
    "section of others": ("/**/insdvl_filter: {parameters: {x: 1.0}}",),
    "no parameters": (OWN + "{}}",),
    "parameters of a value": (OWN + "5}",),
    "parameters of a list": (OWN + "[1]}",),
    "parameters of nothing": ("/**/insdvl_filter:\n  ros__parameters:\n",),
    "parameters twice": ("/a: {ros__parameters: {x: 1.0}, ros__parameters: {y: 1.0}}",),
    "no section": ("ros__parameters: {x: 1.0}",),
    "an empty group at the end": (OWN + "{x: 1.0, a: {}}}",),
    "an empty group": (OWN + "{a: {}, x: 1.0}}",),
    "keys of all kinds": (OWN + "{'1': 1.0, 2: 2.0, true: 3.0, ~: 4.0}}",),
    "two documents": (ALL + "{x: 1.0}}\n---\n" + OWN + "{y: 2.0}}",),
    "tab": ("/**:\n\tros__parameters: {x: 1.0}",),
    "a wrong list of another node": ("/b: {ros__parameters: {x: [1, 2.5]}}",),
    "an empty list of another node": ("/b: {ros__parameters: {x: []}}\n" + OWN + "{x: 2.0}}",),
    "mark of the byte order": ("\ufeff" + OWN + "{x: 2.0}}",),
}
FILES |= {f"value {text!r}": (f"/**:\n  ros__parameters:\n    x: {text}\n",) for text in VALUES}

ARGUMENTS = {
    "after a file": [OWN + "{x: 2.0}}", "-p x:=5.0"],
    "before a file": ["-p x:=5.0", OWN + "{x: 2.0}}"],
    "after shared and own": [ALL + "{x: 1.0}}\n" + OWN + "{x: 2.0}}", "-p x:=5.0"],
    "of the node": [ALL + "{x: 1.0}}\n" + OWN + "{x: 2.0}}", "-p insdvl_filter:x:=5.0"],
    "of another type": [ALL + "{x: 1}}", "-p x:=2.5"],
    "a list": ["-p x:=[1, 2]"],
    "no value": ["-p x:=[]"],
}


def of_rcl(arguments: list[str], namespace: str) -> dict[str, Any] | None:
    """The values that rclpy finds for a node; None where rcl does not start."""
    context = Context()
    try:
        context.init(args=["--ros-args", *arguments])
    except RuntimeError:
        return None
    node = Node(
        "insdvl_filter", context=context, namespace=namespace, start_parameter_services=False
    )
    found = {
        name: [] if override.type_ == Parameter.Type.NOT_SET else override.value
        for name, override in node._parameter_overrides.items()
    }
    node.destroy_node()
    context.shutdown()
    return found


def plain(values: dict[str, Any]) -> dict[str, str]:
    """Values with their types, also of nan and of lists."""
    return {
        name: repr(value if isinstance(value, bool | int | float | str) else list(value))
        for name, value in values.items()
    }


def test_files_are_read_as_rcl_reads_them(tmp_path: Path) -> None:
    """In the root and in a namespace, refusals too."""
    differ, refused = [], 0
    for k, (case, texts) in enumerate(FILES.items()):
        paths = [tmp_path / f"{k}_{i}.yaml" for i in range(len(texts))]
        for path, text in zip(paths, texts, strict=True):
            path.write_text(text, encoding="utf-8")
        arguments = [word for path in paths for word in ("--params-file", str(path))]
        for namespace in ("", "/auv") if "value" not in case else ("",):
            rcl = of_rcl(arguments, namespace)
            try:
                given = effective(read(paths), f"{namespace}/insdvl_filter")
                ours = plain({name: one.value for name, one in given.items()})
            except ParameterError:
                ours = None
            if (None if rcl is None else plain(rcl)) != ours:
                differ.append((case, namespace, rcl, ours))
            refused += rcl is None
    assert differ == []
    assert refused > 20


def test_arguments_are_merged_as_rcl_merges_them(tmp_path: Path) -> None:
    for k, (case, given) in enumerate(ARGUMENTS.items()):
        arguments, files = [], []
        for i, one in enumerate(given):
            if one.startswith("-p "):
                arguments += ["-p", one.removeprefix("-p ")]
                files.append(argument(one.removeprefix("-p ")))
            else:
                (tmp_path / f"{k}_{i}.yaml").write_text(one)
                arguments += ["--params-file", str(tmp_path / f"{k}_{i}.yaml")]
                files += read([tmp_path / f"{k}_{i}.yaml"])
        ours = {name: one.value for name, one in effective(files, "/insdvl_filter").items()}
        rcl = of_rcl(arguments, "")
        assert rcl is not None
        assert plain(rcl) == plain(ours), case


@pytest.mark.parametrize("text", ["[[1.0, 2.0]]", "[1.0, [2.0]]", "[{a: 1.0}]"])
def test_lists_that_rcl_flattens_in_silence_are_refused(tmp_path: Path, text: str) -> None:
    path = tmp_path / "file.yaml"
    path.write_text(ALL + f"{{x: {text}}}}}")
    assert of_rcl(["--params-file", str(path)], "") is not None
    with pytest.raises(ParameterError, match="'x' in line 1 has lists or names in a list"):
        read([path])


# ---------------------------------------------------------------- a node


@pytest.fixture
def context() -> Iterator[Context]:
    context = Context()
    context.init()
    yield context
    context.shutdown()


class Told(InsdvlNode[FilterParameters]):
    """A node that remembers its warnings."""

    def __init__(self, context: Context, *arguments: str, **options: Any) -> None:
        self.told: list[str] = []
        words = ["--ros-args", *arguments]
        super().__init__(
            "insdvl_filter", FilterParameters, context=context, cli_args=words, **options
        )

    def get_logger(self) -> Any:
        """A logger of warnings only."""
        return self

    def warning(self, text: str) -> None:
        """Remember it."""
        self.told.append(text)


def node_of(context: Context, folder: Path, *texts: str, **options: Any) -> Told:
    arguments = []
    for k, text in enumerate(texts):
        (folder / f"{k}.yaml").write_text(text)
        arguments += ["--params-file", str(folder / f"{k}.yaml")]
    node = Told(context, *arguments, **options)
    node.destroy_node()
    return node


def test_a_vehicle_wide_file_may_have_what_is_for_others(context: Context, tmp_path: Path) -> None:
    text = ALL + "{imu: {rate: 200}, foreign: {a: 1, b: x}}}\n" + OWN + "{max_delay: 3}}"
    node = node_of(context, tmp_path, text)
    assert node.parameters.imu.rate == 200.0
    assert node.parameters.max_delay == 3.0
    (told,) = node.told
    assert "unknown parameters are ignored in section '/**': foreign.a, foreign.b" in told
    with pytest.raises(ParameterError, match=r"0.yaml, line 1, section .*'foreign'"):
        node_of(context, tmp_path, OWN + "{foreign: 1}}")


def test_a_file_that_does_not_reach_the_node_is_told(context: Context, tmp_path: Path) -> None:
    texts = ("/**/insdvl_filtr: {ros__parameters: {max_delay: 3.0}}", OWN + "{max_delay: 4.0}}")
    node = node_of(context, tmp_path, *texts)
    assert node.parameters.max_delay == 4.0
    (told,) = node.told
    assert "0.yaml: none of the file's values reached this node, /insdvl_filter" in told
    renamed = node_of(context, tmp_path, texts[1], namespace="/auv")
    assert renamed.told == []
    assert renamed.parameters.max_delay == 4.0


def test_an_argument_without_effect_is_told(context: Context, tmp_path: Path) -> None:
    (tmp_path / "0.yaml").write_text(ALL + "{max_delay: 1.0}}\n" + OWN + "{max_delay: 3.0}}")
    file = ("--params-file", str(tmp_path / "0.yaml"))
    node = Told(context, *file, "-p", "max_delay:=5.0")
    node.destroy_node()
    assert node.parameters.max_delay == 3.0
    (told,) = node.told
    assert "-p max_delay has no effect" in told
    node = Told(context, *file, "-p", "insdvl_filter:max_delay:=5.0")
    node.destroy_node()
    assert node.parameters.max_delay == 5.0
    assert node.told == []


def test_an_argument_for_a_node_without_its_namespace_is_told(context: Context) -> None:
    """ROS ignores it without a word: the name of the node does not have the namespace."""
    rule = ("-p", "insdvl_filter:max_delay:=3.0")
    node = Told(context, *rule, namespace="/auv")
    node.destroy_node()
    assert node.parameters.max_delay == 2.0
    assert node.told == [
        "-p insdvl_filter:max_delay has no effect: this node is /auv/insdvl_filter; use "
        "-p max_delay:=VALUE"
    ]
    node = Told(context, "-p", "insdvl_tuner:rate:=2.0", others=[TunerParameters])
    node.destroy_node()
    assert node.told == []
