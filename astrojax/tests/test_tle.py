"""Reading elements: two and three lines, orbit mean-elements messages, and what is said of malformed ones."""

import csv
import io
import json

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from sgp4 import omm
from sgp4.alpha5 import to_alpha5
from sgp4.api import Satrec
from sgp4.exporter import export_omm

from astrojax.orbits.sgp4 import alpha5_to_number, number_to_alpha5, parse_tle, read_omm, read_tle, stack_elements

LINE1 = "1 25544U 98067A   08264.51782528 -.00002182  00000-0 -11606-4 0  2927"
LINE2 = "2 25544  51.6416 247.4627 0006703 130.5360 325.0288 15.72125391563537"
FIELDS = ("no_kozai", "ecco", "inclo", "nodeo", "argpo", "mo", "bstar")


def same(elements, satellite, rtol=1e-15):
    ours = np.array(elements[2:]) * np.array([60.0, 1, 1, 1, 1, 1, 1])
    np.testing.assert_allclose(ours, [getattr(satellite, name) for name in FIELDS], rtol=rtol)
    days = (satellite.jdsatepoch - 2400000.5 - float(elements.day)) + satellite.jdsatepochF
    assert abs(days * 86400.0 - elements.seconds) < 2e-6  # the message has whole microseconds


def test_two_and_three_lines():
    found = parse_tle(LINE1, LINE2)
    same(found.elements, Satrec.twoline2rv(LINE1, LINE2))
    assert (found.number, found.designator, found.name) == (25544, "98067A", "")
    text = f"# a comment\n0 ISS (ZARYA)\n{LINE1}\n{LINE2}\n\n{LINE1}\n{LINE2}\nSPACE STATION\r\n{LINE1}\r\n{LINE2}\r\n"
    assert [s.name for s in read_tle(text)] == ["ISS (ZARYA)", "", "SPACE STATION"]
    assert stack_elements([s.elements for s in read_tle(text)]).e.shape == (3,)
    assert read_tle("") == []
    with pytest.raises(ValueError, match="elements: expected at least one set"):
        stack_elements([])


def spoiled(line, at, text):
    return line[: at - 1] + text + line[at - 1 + len(text) :]


@pytest.mark.parametrize(
    "one, two, message",
    [
        (LINE1[:68], LINE2, r"line 1: expected at least 69 columns, got 68"),
        (spoiled(LINE1, 69, "3"), LINE2, r"line 1, column 69 \(checksum\): expected 7, got '3'"),
        (LINE2, LINE1, r"line 1, columns 1-2: expected '1 ', got '2 '"),
        (LINE1, spoiled(LINE2, 9, " 5x.6416"), r"line 2, columns 9-16 \(inclination\): expected a decimal number"),
        (LINE1, spoiled(LINE2, 9, "251.6416"), r"line 2, columns 9-16 \(inclination\): expected 0 to 180, got"),
        (
            LINE1,
            spoiled(LINE2, 27, "00o6703"),
            r"line 2, columns 27-33 \(eccentricity\): expected digits, got '00o6703'",
        ),
        (LINE1, spoiled(LINE2, 3, "25545"), r"line 2, columns 3-7 \(satellite number\): expected that of line 1"),
        (spoiled(LINE1, 3, "I5544"), LINE2, r"line 1, columns 3-7 \(satellite number\): expected digits, or a capital"),
        (spoiled(LINE1, 21, "367"), LINE2, r"line 1, columns 21-23 \(epoch day\): expected 1 to 366, got '367'"),
        (spoiled(LINE1, 24, ","), LINE2, r"line 1, columns 24-24 \(epoch day\): expected a decimal point"),
        (spoiled(LINE1, 54, "-116x6-4"), LINE2, r"line 1, columns 54-61 \(B\*\): expected a sign, five digits"),
        (spoiled(LINE1, 30, "é"), LINE2, r"line 1, column 30: expected ASCII, got 'é'"),
        (LINE1, spoiled(LINE2, 53, "00.00000000"), r"line 2, columns 53-63 \(mean motion\): expected more than 0"),
    ],
)
def test_malformed_lines_are_named_by_line_and_column(one, two, message):
    with pytest.raises(ValueError, match=message):
        parse_tle(one, two, check="column 69" in message or "69 columns" in message)


def test_malformed_files():
    with pytest.raises(ValueError, match="line 2: a line 1 without a line 2"):
        read_tle(f"NAME\n{LINE1}\n")
    with pytest.raises(ValueError, match="line 3: a line 2 without a line 1"):
        read_tle(f"{LINE1}\n{LINE2}\n{LINE2}\n")
    with pytest.raises(ValueError, match=r"line 4, columns 9-16 \(inclination\)"):
        read_tle(f"{LINE1}\n{LINE2}\n{LINE1}\n{spoiled(LINE2, 9, ' 51,6416')}\n", check=False)


@given(st.integers(0, 339999))
def test_alpha5(number):
    assert number_to_alpha5(number) == to_alpha5(number)
    assert alpha5_to_number(number_to_alpha5(number)) == number


def test_alpha5_in_lines():
    one, two = spoiled(LINE1, 3, "Z9999"), spoiled(LINE2, 3, "Z9999")
    assert parse_tle(one, two, check=False).number == 339999
    with pytest.raises(ValueError, match="number: expected 0 to 339999, got 340000"):
        number_to_alpha5(340000)


@given(st.text(max_size=200))
def test_any_text_is_read_or_refused(text):
    for read in (read_tle, read_omm):
        try:
            read(text)
        except ValueError:
            pass


def messages():
    """One satellite as `sgp4` exports it, which is as CelesTrak publishes it."""
    return export_omm(Satrec.twoline2rv(LINE1, LINE2), "ISS (ZARYA)")


def written(fields, format):
    fields = {key: str(value) for key, value in fields.items()}
    if format == "json":
        return json.dumps([fields, fields])
    if format == "csv":
        out = io.StringIO()
        table = csv.DictWriter(out, fields)
        table.writeheader()
        table.writerows([fields, fields])
        return out.getvalue()
    if format == "kvn":
        return "\n".join(["CCSDS_OMM_VERS = 2.0", "COMMENT none", *(f"{k} = {v}" for k, v in fields.items()), ""] * 2)
    inner = "".join(f"<{key}>{value}</{key}>" for key, value in fields.items())
    segment = f"<segment><metadata/><data><meanElements>{inner}</meanElements></data></segment>"
    return f'<?xml version="1.0"?><ndm xmlns="urn:ccsds"><omm><body>{segment * 2}</body></omm></ndm>'


@pytest.mark.parametrize("format", ["json", "xml", "kvn", "csv"])
@pytest.mark.parametrize("named", [True, False])
def test_messages(format, named):
    found = read_omm(written(messages(), format), format if named else None)
    assert len(found) == 2
    satellite = Satrec()
    omm.initialize(satellite, messages())
    for one in found:
        same(one.elements, satellite)
        same(one.elements, Satrec.twoline2rv(LINE1, LINE2), rtol=1e-9)
        assert (one.number, one.name) == (25544, "ISS (ZARYA)")


@pytest.mark.parametrize("format", ["json", "xml", "kvn", "csv"])
@pytest.mark.parametrize(
    "field, value, message",
    [
        ("ECCENTRICITY", "1.5", "ECCENTRICITY: expected 0 to 1, got 1.5"),
        ("INCLINATION", "x", "INCLINATION: expected a number, got 'x'"),
        ("MEAN_MOTION", "nan", "MEAN_MOTION: expected 0 to 20, got nan"),
        ("EPOCH", "2020-13-01T00:00:00", "EPOCH: expected an ISO 8601"),
        ("REF_FRAME", "GCRF", "REF_FRAME: expected TEME, got 'GCRF'"),
        ("NORAD_CAT_ID", "A1", "NORAD_CAT_ID: expected digits, got 'A1'"),
        ("BSTAR", None, "BSTAR: missing"),
    ],
)
def test_malformed_messages_are_named_by_message_and_field(format, field, value, message):
    fields = messages()
    fields = {k: v for k, v in fields.items() if k != field} | ({field: value} if value else {})
    with pytest.raises(ValueError, match=rf"(message 1|line 2).*, {message}"):
        read_omm(written(fields, format))


def test_malformed_texts():
    for text, message in [
        ('[{"EPOCH": }]', "line 1, column 12: not JSON"),
        ("[1]", "message 1: expected an object with fields, got int"),
        ("<a>\n<b></a>", "line 2, column"),
        ("<a></a>", "XML without a segment"),
        ("A = 1\nB", "line 2: expected a keyword, = and a value, got 'B'"),
        ("A,B\n1\n", "line 2: expected 2 columns"),
    ]:
        with pytest.raises(ValueError, match=message):
            read_omm(text)
    with pytest.raises(ValueError, match="format: expected one of json, xml, kvn, csv, got 'tle'"):
        read_omm("", "tle")
