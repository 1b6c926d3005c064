"""Jaw files: at which angle the jaw of one instrument on one arm closes, and when that was found (JSON)."""

import json
from dataclasses import dataclass
from pathlib import Path

from shared.calibration.documents import Document, parse_documents, read_text
from shared.calibration.jaw.estimate import FEWEST_CLOSINGS, WIDEST_RAD, Estimate
from shared.calibration.made import MADE, made_ns, made_text
from shared.calibration.numbers import array, whole_number
from shared.calibration.stated import CalibrationError

FARTHEST_RAD = 1.0
"""Of a closing from 0. A jaw of an instrument opens by 1.4 rad at most, and one that closed at 1 would not hold thread;
5.7, which is 0.1 rad in degrees, is beyond it."""
APART_RAD = 0.3
"""Of a set point from what is measured there: farther apart, a bridge holds."""


@dataclass(frozen=True)
class JawZero:
    """Where a jaw closes.

    Fields:
        arm, instrument: as the rig calls the arm, and its console the tool.
        closes_rad: as measured; told_rad: the set point at which it does, for the two differ by an offset.
        deviation_rad: with which a jaw closes there once more.
        closings: how many of them told.
        made_ns: when, since 1970 (UTC); 0 where the file does not say.
    """

    arm: str
    instrument: str
    closes_rad: float
    told_rad: float
    deviation_rad: float
    closings: int
    made_ns: int = 0


def jaw_zero_of(found: Estimate, arm: str, instrument: str, at_ns: int) -> JawZero:
    """What was found, of that arm and instrument, at that time."""
    of = found.closes_rad, found.told_rad, found.deviation_rad, len(found.contacts)
    return JawZero(arm, instrument, *of, made_ns=at_ns)


def jaw_zero_text(zero: JawZero) -> str:
    """What a file holds."""
    told = {
        MADE: made_text(zero.made_ns),
        "arm": zero.arm,
        "instrument": zero.instrument,
        "closes_rad": zero.closes_rad,
        "told_rad": zero.told_rad,
        "deviation_rad": zero.deviation_rad,
        "closings": zero.closings,
    }
    return json.dumps(told, indent=2) + "\n"


def read_jaw_zero(path: Path) -> JawZero:
    """Read a jaw file.

    Raises:
        CalibrationError: where it is none, or tells what no jaw does; in one sentence with the path.
    """
    try:
        documents = parse_documents(read_text(path))
        if len(documents) != 1:
            raise CalibrationError(f"it holds {len(documents)} documents where one is expected")
        return _checked(documents[0], made_ns((path,)) or 0)
    except CalibrationError as error:
        raise CalibrationError(f"{path}: {error}") from None


def _checked(found: Document, at_ns: int) -> JawZero:
    arm, instrument = _text(found, "arm"), _text(found, "instrument")
    closes, told, deviation = (_number(found, name) for name in ("closes_rad", "told_rad", "deviation_rad"))
    if abs(closes) > FARTHEST_RAD or abs(told - closes) > APART_RAD:
        raise CalibrationError(
            f"the jaw would close at {closes:.3g} rad when told {told:.3g} rad: the first is within {FARTHEST_RAD:g} "
            f"rad of 0, and the two are within {APART_RAD:g} rad of each other; are they in degrees?"
        )
    if not 0 < deviation <= WIDEST_RAD:
        raise CalibrationError(f"deviation_rad must lie above 0 and up to {WIDEST_RAD:g}, and is {deviation:g}")
    if (closings := whole_number(found.get("closings"), "closings")) < FEWEST_CLOSINGS:
        raise CalibrationError(f"it was found by {closings} closings, and {FEWEST_CLOSINGS} are needed")
    return JawZero(arm, instrument, closes, told, deviation, closings, at_ns)


def _number(found: Document, name: str) -> float:
    if name not in found:
        raise CalibrationError(f"it is no jaw file: it has no {name}, as suturegrasp calibrate jaw writes it")
    values = array(found[name], name)
    if values.size != 1:
        raise CalibrationError(f"{name} must be one number")
    return float(values.item())


def _text(found: Document, name: str) -> str:
    told = found.get(name)
    if not isinstance(told, str) or not told.strip():
        raise CalibrationError(f"it is no jaw file: it does not say of which {name} it is")
    return told
