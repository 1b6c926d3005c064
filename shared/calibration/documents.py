"""YAML, XML and JSON text as nested mappings and lists of strings, whoever wrote it.

Numbers stay text, so that what a number is gets decided in one place. OpenCV's own reader is not used: on damaged
files it prints to the terminal and has read outside its buffer.
"""

import itertools
import json
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TypeAlias
from xml.etree import ElementTree

from ruamel.yaml import YAML
from ruamel.yaml.events import AliasEvent

from shared.calibration.stated import CalibrationError

Node: TypeAlias = "Mapping[str, Node] | Sequence[Node] | str | None"
Document: TypeAlias = Mapping[str, Node]

LARGEST_FILE_BYTES = 1 << 20
_DEEPEST_NESTING = 20
_TOO_DEEP = f"it nests deeper than {_DEEPEST_NESTING} levels, so it is no calibration"


def read_text(path: Path) -> str:
    """The text of a file.

    Raises:
        CalibrationError: where it is missing, unreadable, empty, no text, or far too large for a calibration.
    """
    try:
        if not path.exists():
            raise CalibrationError("there is no such file or folder")
        if not path.is_file():
            raise CalibrationError("it is not a file")
        if path.stat().st_size > LARGEST_FILE_BYTES:
            raise CalibrationError("it is larger than 1 MB, so it is no calibration; give the calibration file")
        text = path.read_bytes().decode("utf-8-sig")
    except OSError as error:
        raise CalibrationError(f"it cannot be read ({error.strerror})") from None
    except UnicodeDecodeError:
        raise CalibrationError("it is not a text file; give the calibration file") from None
    if not text.strip():
        raise CalibrationError("it is empty")
    return text


def parse_documents(text: str) -> tuple[Document, ...]:
    """The documents of a text in YAML (of which OpenCV writes a dialect), XML or JSON; at least one.

    Raises:
        CalibrationError: where it is none of these, or nests deeper than any calibration.
    """
    _check_brackets(text)
    start = text.lstrip()
    if start.startswith("<"):
        documents = [_parse_xml(text)]
    elif start.startswith("{"):
        documents = [_parse_json(text)]
    else:
        documents = _parse_yaml(text)
    mappings = tuple(document for document in documents if isinstance(document, Mapping) and document)
    if not mappings:
        raise CalibrationError("it holds no names with values, so it is no calibration file that is known here")
    for document in mappings:
        _check_nesting(document, _DEEPEST_NESTING)
    return mappings


def _parse_json(text: str) -> Node:
    def unique(pairs: list[tuple[str, Node]]) -> Node:
        if len(dict(pairs)) < len(pairs):
            raise CalibrationError("it gives the same name twice")
        return dict(pairs)

    try:
        return json.loads(text, object_pairs_hook=unique, parse_float=str, parse_int=str, parse_constant=str)
    except json.JSONDecodeError as error:
        raise CalibrationError(f"it is not valid JSON (line {error.lineno})") from None


def _parse_yaml(text: str) -> list[Node]:
    text = re.sub(r"\A\s*%YAML.*", "", text)  # OpenCV writes `%YAML:1.0`, which no other parser takes
    try:
        if "*" in text and any(isinstance(event, AliasEvent) for event in _yaml().parse(text)):
            raise CalibrationError("it uses YAML aliases, which a calibration has no need of; write the numbers out")
        return list(_yaml().load_all(text))
    except CalibrationError:
        raise
    except Exception as error:  # the parser raises classes of many kinds on damaged text
        line = getattr(getattr(error, "problem_mark", None), "line", None)
        where = "" if line is None else f" (line {line + 1})"
        raise CalibrationError(f"it is not valid YAML{where}") from None


def _yaml() -> YAML:
    return YAML(typ="base", pure=True)


def _parse_xml(text: str) -> Node:
    if "<!DOCTYPE" in text or "<!ENTITY" in text:
        raise CalibrationError("it declares XML entities or a document type, which OpenCV never writes")
    try:
        return _xml_node(ElementTree.fromstring(text))  # noqa: S314  (entities are refused above)
    except ElementTree.ParseError as error:
        raise CalibrationError(f"it is not valid XML (line {error.position[0]})") from None
    except (RecursionError, ValueError):
        raise CalibrationError("it is not valid XML") from None


def _xml_node(element: ElementTree.Element) -> Node:
    children = list(element)
    if not children:
        words = (element.text or "").split()
        return words[0] if len(words) == 1 else words
    if all(child.tag == "_" for child in children):
        return [_xml_node(child) for child in children]
    names = [child.tag for child in children]
    if len(set(names)) < len(names):
        raise CalibrationError("it gives the same name twice")
    return {child.tag: _xml_node(child) for child in children}


def _check_brackets(text: str) -> None:
    """The YAML parser takes time quadratic in the depth of brackets, so that is looked at first."""
    depths = itertools.accumulate((char in "[{") - (char in "]}") for char in text)
    if max(depths, default=0) > _DEEPEST_NESTING:
        raise CalibrationError(_TOO_DEEP)


def _check_nesting(node: Node, depth: int) -> None:
    if depth == 0:
        raise CalibrationError(_TOO_DEEP)
    if isinstance(node, Mapping):
        for value in node.values():
            _check_nesting(value, depth - 1)
    elif isinstance(node, Sequence) and not isinstance(node, str):
        for value in node:
            _check_nesting(value, depth - 1)
