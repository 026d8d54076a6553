"""YAML files as plain data. What is large, deep or ambiguous is refused.

YAML has aliases, with which a few lines stand for billions of values. ROS 2 does not take them in
its parameter files and rosbag2 does not write them: here they are refused as well.
"""

from pathlib import Path
from typing import Any

import yaml

from insdvl.files import read

MAX_BYTES = 2**20  # a thousand parameters or topics have less
MAX_DEPTH = 50  # levels of brackets and indentation; parameters and recordings have less than ten
MAX_TEXT = 2**16  # characters of one value; the qualities of service of many publishers are one

#: The fast one, where PyYAML was built with it.
_SafeLoader: Any = getattr(yaml, "CSafeLoader", yaml.SafeLoader)


class YamlError(ValueError):
    """A file that is no YAML, or that holds what is refused."""


class _Loader(_SafeLoader):
    """Of a key that is there twice, YAML's own loaders take the last and say nothing."""

    def construct_mapping(self, node: Any, deep: bool = False) -> dict[Any, Any]:
        lines: dict[str, int] = {}
        for key, _ in node.value:
            line = key.start_mark.line + 1
            if not isinstance(key, yaml.ScalarNode):
                raise YamlError(f"line {line} has a key that is no text")
            if key.value in lines:
                raise YamlError(f"key {key.value!r} is in line {lines[key.value]} and in {line}")
            lines[key.value] = line
        mapping: dict[Any, Any] = super().construct_mapping(node, deep)
        return mapping


def load(path: Path) -> Any:
    """The document in a file: dictionaries, lists and plain values.

    Raises:
        OSError: The file cannot be read, or is too large.
        YamlError: It is no YAML, or has an alias, too many levels, too long a value, or a key that
            is given twice.
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
    except Exception as error:  # a tag on a text that is none of its kind raises anything
        raise YamlError(str(error)) from error


def _check(text: str) -> None:
    """Go through the document without making anything of it."""
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
