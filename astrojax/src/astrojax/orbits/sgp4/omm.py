"""Orbit mean-elements messages as CelesTrak and Space-Track publish them: JSON, XML, KVN and CSV (host side).

Source: CCSDS 502.0-B-3, Orbit Data Messages, chapter 4 and annex on SGP4.
"""

import csv
import io
import json
import math
import xml.etree.ElementTree as ElementTree

from astrojax.orbits.sgp4.element_set import ElementSet, elements_in_degrees
from astrojax.time import mjd_from_calendar

FORMATS = ("json", "xml", "kvn", "csv")
_FIXED = {"TIME_SYSTEM": "UTC", "REF_FRAME": "TEME", "MEAN_ELEMENT_THEORY": "SGP4", "CENTER_NAME": "EARTH"}
_THEORIES = ("SGP4", "SGP/SGP4")
_RANGES = {
    "MEAN_MOTION": (0.0, 20.0),
    "ECCENTRICITY": (0.0, 1.0),
    "INCLINATION": (0.0, 180.0),
    "RA_OF_ASC_NODE": (-360.0, 360.0),
    "ARG_OF_PERICENTER": (-360.0, 360.0),
    "MEAN_ANOMALY": (-360.0, 360.0),
    "BSTAR": (-math.inf, math.inf),
}


def read_omm(text: str, format: str | None = None) -> list[ElementSet]:
    """Elements of all satellites in a text of orbit mean-elements messages.

    Args:
        text: the contents of a file.
        format: "json", "xml", "kvn" or "csv"; found from the text where None.

    Raises:
        ValueError: an unknown format, a text that is not of the format, or a message whose field is missing, not a
            number, out of range, or not SGP4's (time UTC, frame TEME); names message, field and line where known.
    """
    format = format or _guess(text)
    if format not in FORMATS:
        raise ValueError(f"format: expected one of {', '.join(FORMATS)}, got {format!r}")
    messages = {"json": _json, "xml": _xml, "kvn": _kvn, "csv": _csv}[format](text)
    return [_element_set(fields, where) for where, fields in messages]


def _guess(text: str) -> str:
    start = text.lstrip("\ufeff \t\r\n")
    if start[:1] in ("[", "{"):
        return "json"
    if start[:1] == "<":
        return "xml"
    return "kvn" if "=" in start.split("\n", 1)[0] else "csv"


def _json(text: str):
    try:
        found = json.loads(text.lstrip("\ufeff"))
    except json.JSONDecodeError as error:
        raise ValueError(f"line {error.lineno}, column {error.colno}: not JSON: {error.msg}") from error
    found = [found] if isinstance(found, dict) else found
    for i, fields in enumerate(found, 1):
        if not isinstance(fields, dict):
            raise ValueError(f"message {i}: expected an object with fields, got {type(fields).__name__}")
        yield f"message {i}", {key: "" if value is None else str(value) for key, value in fields.items()}


def _xml(text: str):
    try:
        root = ElementTree.fromstring(text.lstrip("\ufeff \t\r\n"))
    except ElementTree.ParseError as error:
        raise ValueError(f"line {error.position[0]}, column {error.position[1] + 1}: not XML: {error}") from error
    segments = [node for node in root.iter() if _tag(node) == "segment"]
    if not segments:
        raise ValueError("XML without a segment: not an orbit mean-elements message")
    for i, segment in enumerate(segments, 1):
        yield f"message {i}", {_tag(node): (node.text or "").strip() for node in segment.iter()}


def _tag(node) -> str:
    return node.tag.rsplit("}", 1)[-1]


def _kvn(text: str):
    start, fields, count = 1, {}, 0
    for i, line in enumerate(text.lstrip("\ufeff").splitlines(), 1):
        line = line.strip()
        if not line or line.startswith("COMMENT"):
            continue
        key, equals, value = (part.strip() for part in line.partition("="))
        if not equals:
            raise ValueError(f"line {i}: expected a keyword, = and a value, got {line!r}")
        if key == "CCSDS_OMM_VERS" or key in fields:
            if "EPOCH" in fields:
                count += 1
                yield f"message {count} (line {start})", fields
            start, fields = i, {}
        fields[key] = value.split("[", 1)[0].strip()  # units may stand in brackets
    if fields:
        yield f"message {count + 1} (line {start})", fields


def _csv(text: str):
    rows = csv.DictReader(io.StringIO(text.lstrip("\ufeff"), newline=""))
    while True:
        try:
            fields = next(rows)
        except StopIteration:
            return
        except csv.Error as error:
            raise ValueError(f"line {rows.line_num}: not CSV: {error}") from error
        if None in fields or None in fields.values():
            raise ValueError(f"line {rows.line_num}: expected {len(rows.fieldnames)} columns")
        yield f"line {rows.line_num}", fields


def _element_set(fields: dict, where: str) -> ElementSet:
    for key, expected in _FIXED.items():
        got = fields.get(key, expected)
        if got != expected and not (key == "MEAN_ELEMENT_THEORY" and got in _THEORIES):
            raise ValueError(f"{where}, {key}: expected {expected}, got {got!r}")

    def number(key: str) -> float:
        low, high = _RANGES[key]
        try:
            value = float(fields[key])
        except KeyError:
            raise ValueError(f"{where}, {key}: missing") from None
        except ValueError:
            raise ValueError(f"{where}, {key}: expected a number, got {fields[key]!r}") from None
        if not low <= value <= high or not math.isfinite(value) or (key == "MEAN_MOTION" and value <= 0.0):
            raise ValueError(f"{where}, {key}: expected {low:g} to {high:g}, got {fields[key]}")
        return value

    try:
        day, seconds = mjd_from_calendar(fields["EPOCH"])
    except KeyError:
        raise ValueError(f"{where}, EPOCH: missing") from None
    except ValueError:
        raise ValueError(f"{where}, EPOCH: expected an ISO 8601 date and time, got {fields['EPOCH']!r}") from None
    catalogue = fields.get("NORAD_CAT_ID", "0")
    if not catalogue.isascii() or not catalogue.isdigit():
        raise ValueError(f"{where}, NORAD_CAT_ID: expected digits, got {catalogue!r}")
    angles = tuple(number(key) for key in ("INCLINATION", "RA_OF_ASC_NODE", "ARG_OF_PERICENTER", "MEAN_ANOMALY"))
    elements = elements_in_degrees(day, seconds, number("MEAN_MOTION"), number("ECCENTRICITY"), angles, number("BSTAR"))
    return ElementSet(fields.get("OBJECT_NAME", ""), int(catalogue), fields.get("OBJECT_ID", ""), elements)
