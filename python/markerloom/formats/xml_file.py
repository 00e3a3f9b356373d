"""XML files of other programs, with errors that name the file."""

from __future__ import annotations

import re
from pathlib import Path
from xml.etree import ElementTree

from markerloom.errors import FormatError
from markerloom.formats.files import read_text


def parse(path: str | Path, root: str, program: str) -> ElementTree.Element:
    """The root element; refuses documents of another kind and documents that define entities."""
    text = read_text(path)
    outside = re.sub(r"<!--.*?-->", "", text, flags=re.DOTALL)
    if "<!DOCTYPE" in outside or "<!ENTITY" in outside:
        raise FormatError(path, f"a document type definition has no place in a {program} file")
    try:
        found = ElementTree.fromstring(text.encode("utf-8") if "encoding=" not in text[:80] else _plain(text))
    except ElementTree.ParseError as error:
        raise FormatError(path, f"not a {program} file: {error}") from None
    if found.tag.rpartition("}")[2] != root:
        raise FormatError(path, f"not a {program} file: its root is <{found.tag}>, not <{root}>")
    return found


def _plain(text: str) -> str:
    """Drop the declaration, whose encoding no longer holds once the text is decoded."""
    start = text.find("?>")
    return text[start + 2 :].lstrip() if text.lstrip().startswith("<?xml") and start >= 0 else text


def child(element: ElementTree.Element, name: str, path: str | Path, *, owner: str) -> ElementTree.Element:
    """The first child of a name; ``owner`` says whose it is in the error."""
    found = element.find(name)
    if found is None:
        raise FormatError(path, f"no <{name}>", where=owner)
    return found


def number(element: ElementTree.Element, name: str, path: str | Path) -> float:
    """A numeric attribute."""
    return numbers(element, name, path, 1)[0]


def numbers(element: ElementTree.Element, name: str, path: str | Path, count: int) -> list[float]:
    """An attribute of several numbers."""
    text = element.get(name)
    if text is None:
        raise FormatError(path, f"attribute {name} is missing", where=f"<{element.tag}>")
    try:
        values = [float(v) for v in text.split()]
    except ValueError:
        raise FormatError(path, f"{name} is not a number: {text[:40]!r}", where=f"<{element.tag}>") from None
    if len(values) != count:
        raise FormatError(path, f"{name} has {len(values)} values, {count} expected", where=f"<{element.tag}>")
    return values
