"""YAML files as plain data. Files that are large, deeply nested or ambiguous are refused.

With aliases a few lines of YAML can stand for billions of values. ROS 2 does not accept them in
parameter files and rosbag2 does not write them, so they are refused here as well.
"""

from pathlib import Path
from typing import Any

import yaml

from insdvl.files import read

MAX_BYTES = 2**20  # a thousand parameters or topics need less
MAX_DEPTH = 50  # nested levels; parameters and recordings have fewer than ten
MAX_TEXT = 2**16  # characters of one value; rosbag2 writes the QoS of all publishers in one

#: The loader in C, if PyYAML was built with it.
_SafeLoader: Any = getattr(yaml, "CSafeLoader", yaml.SafeLoader)


class YamlError(ValueError):
    """A file that is not valid YAML, or that contains something that is refused."""


class _Loader(_SafeLoader):
    """Refuses duplicate keys, of which PyYAML silently takes the last."""

    def construct_mapping(self, node: Any, deep: bool = False) -> dict[Any, Any]:
        lines: dict[str, int] = {}
        for key, _ in node.value:
            line = key.start_mark.line + 1
            if not isinstance(key, yaml.ScalarNode):
                raise YamlError(f"line {line} has a key that is not text")
            if key.value in lines:
                raise YamlError(
                    f"duplicate key {key.value!r} in lines {lines[key.value]} and {line}"
                )
            lines[key.value] = line
        mapping: dict[Any, Any] = super().construct_mapping(node, deep)
        return mapping


def load(path: Path) -> Any:
    """The document in a file: dictionaries, lists and plain values.

    Raises:
        OSError: The file cannot be read or is too large.
        YamlError: It is not valid YAML, or it has an alias, too many levels, a value that is too
            long, or a duplicate key.
    """
    data = read(path, MAX_BYTES)
    try:
        text = data.decode("utf-8")
        _check(text)
        loader = _Loader(text)
        try:
            return loader.get_single_data()
        finally:
            loader.dispose()
    except YamlError:
        raise
    except Exception as error:  # a tag that does not fit its text may raise anything
        raise YamlError(str(error)) from error


def _check(text: str) -> None:
    """Check the document before any object is made from it."""
    depth = 0
    for event in yaml.parse(text, Loader=_SafeLoader):
        line = event.start_mark.line + 1
        if isinstance(event, yaml.AliasEvent):
            raise YamlError(f"line {line} has an alias, *{event.anchor}")
        if isinstance(event, yaml.ScalarEvent) and len(event.value) > MAX_TEXT:
            raise YamlError(
                f"line {line} has a value of {len(event.value)} characters, more than {MAX_TEXT}"
            )
        if isinstance(event, yaml.CollectionStartEvent):
            depth += 1
            if depth > MAX_DEPTH:
                raise YamlError(f"line {line} has more than {MAX_DEPTH} levels")
        elif isinstance(event, yaml.CollectionEndEvent):
            depth -= 1
