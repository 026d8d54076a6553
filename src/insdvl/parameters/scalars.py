"""What a text in a parameter file means to rcl: a bool, an integer, a number, else a string.

rcl asks C: an integer is what strtoll with base 0 takes as a whole (`010` is 8), a number is what
strtod takes as a whole and can hold (`2e2`, `.5`, `nan`), with YAML's `.inf` and `.nan` beside. So
`~` and `3_600.0` are strings.
"""

import math
import re
import sys

from insdvl.yaml_files import Scalar, YamlError

#: Types of values, in the order in which rcl tries them.
TYPES = (bool, int, float, str)
_NAMES = ("bool", "integer", "double", "string")

_TRUE = ("Y", "y", "yes", "Yes", "YES", "true", "True", "TRUE", "on", "On", "ON")
_FALSE = ("N", "n", "no", "No", "NO", "false", "False", "FALSE", "off", "Off", "OFF")

_SPACE = " \t\n\v\f\r"  # C skips it in front
_INTEGER = re.compile(r"([+-]?)(0[xX][0-9a-fA-F]+|0[0-7]*|[1-9][0-9]*)")
_DECIMAL = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?", re.ASCII)
_HEXADECIMAL = re.compile(r"[+-]?0[xX]([0-9a-fA-F]+\.?[0-9a-fA-F]*|\.[0-9a-fA-F]+)([pP][+-]?\d+)?")
_SPECIAL = re.compile(r"[+-]?(inf|infinity|nan)", re.IGNORECASE)
_OF_YAML = re.compile(r"[+-]?\.(inf|Inf|INF)|\.(nan|NaN|NAN)")


def type_name(value: bool | int | float | str) -> str:
    """What rcl calls the type of a value."""
    return _NAMES[TYPES.index(type(value))]


def scalar(node: Scalar) -> bool | int | float | str:
    """The value of a text.

    Raises:
        YamlError: There is none.
    """
    text = node.text
    if node.is_string:
        return text
    if not text:
        raise YamlError(f"No value at line {node.line}")
    if text in _TRUE or text in _FALSE:
        return text in _TRUE
    integer = _integer(text.lstrip(_SPACE))
    if integer is not None:
        return integer
    number = _number(text)
    return text if number is None else number


def _integer(text: str) -> int | None:
    """What strtoll makes of a whole text; None where it takes less, or is out of range."""
    found = _INTEGER.fullmatch(text)
    if found is None:
        return None
    sign, digits = found.groups()
    if len(digits) > 30:  # Python limits the conversion, and 64 bits have fewer
        return None
    base = 16 if digits[:2] in ("0x", "0X") else 8 if digits[0] == "0" else 10
    value = int(sign + digits, base)
    return value if -(2**63) <= value < 2**63 else None


def _number(text: str) -> float | None:
    """What strtod makes of a whole text; None where it takes less, or is out of range."""
    if _OF_YAML.fullmatch(text):
        return float(text.replace(".", ""))
    text = text.lstrip(_SPACE)
    if _SPECIAL.fullmatch(text):
        return float(text)
    decimal, hexadecimal = _DECIMAL.fullmatch(text), _HEXADECIMAL.fullmatch(text)
    if decimal:
        value, digits = float(text), decimal[1]
    elif hexadecimal:
        try:
            value, digits = float.fromhex(text), hexadecimal[1]
        except OverflowError:
            return None
    else:
        return None
    is_zero = not digits.strip("0.")
    holds = is_zero or sys.float_info.min <= abs(value) < math.inf
    return value if holds else None
