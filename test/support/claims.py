"""Sentences of pages, held against numbers: a claim is a part of one, with N for each number."""

import re
from collections.abc import Iterable, Sequence

NUMBER = r"\d+(?:\.\d+)?"


def one_line(text: str) -> str:
    """Without the line breaks."""
    return " ".join(text.split())


def check(claim: str, text: str, values: Sequence[float]) -> None:
    """The text makes the claim, with these numbers to the digits that it tells."""
    found = re.search(_pattern(claim), one_line(text))
    assert found, f"not in the text: {claim}"
    for told, value in zip(found.groups(), values, strict=True):
        assert f"{value:.{len(told.partition('.')[2])}f}" == told, claim


def unclaimed(text: str, claims: Iterable[str]) -> list[str]:
    """The numbers of a text that belong to none of the claims."""
    left = one_line(text)
    for claim in claims:
        left = re.sub(_pattern(claim), "", left)
    return re.findall(NUMBER, left)


def _pattern(claim: str) -> str:
    return re.sub(r"\bN\b", lambda _: f"(-?{NUMBER})", re.escape(claim))
