"""The JSON of `suturegrasp reconstruct`, field by field."""

import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from scipy.interpolate import BSpline

FIELDS: dict[str, Any] = {
    "status": str,
    "reason": (str, type(None)),
    "unit": (str, type(None)),
    "frame": str,
    "degree": int,
    "knots": list,
    "control_points": list,
    "confidence": dict,
    "posterior": (dict, type(None)),
    "crossings": list,
    "unseen": list,
    "observations": int,
    "timings_ms": dict,
}


def check_contract(document: dict[str, Any]) -> None:
    """What holds for every result, whatever its status."""
    for field, kind in FIELDS.items():
        assert isinstance(document[field], kind), field
    assert document["status"] in ("ok", "failed")
    assert (document["reason"] is None) == (document["status"] == "ok")
    assert document["unit"] in ("m", "cm", "mm", "um", None)
    assert document["frame"] == "left rectified camera"
    assert document["degree"] == 3
    assert {"rectify", "segment", "match", "reconstruct"} <= set(document["timings_ms"])
    for ms in document["timings_ms"].values():
        assert isinstance(ms, int | float)
        assert ms >= 0
    assert set(document["confidence"]) == {"s", "value"}
    s, value = np.array(document["confidence"]["s"]), np.array(document["confidence"]["value"])
    assert s.shape == value.shape
    assert ((s >= 0) & (s <= 1) & (value >= 0) & (value <= 1)).all()
    assert all(len(stretch) == 2 and 0 <= stretch[0] <= stretch[1] <= 1 for stretch in document["unseen"])
    if document["posterior"] is not None:
        s, covariance = np.array(document["posterior"]["s"]), np.array(document["posterior"]["covariance"])
        assert len(s) >= 100
        np.testing.assert_allclose(s, np.linspace(0, 1, len(s)), atol=1e-12)
        assert covariance.shape == (len(s), 3, 3)
        assert (np.linalg.eigvalsh(covariance) >= -1e-12 * np.abs(covariance).max()).all()


def check_curve(document: dict[str, Any]) -> None:
    """What holds for a curve: a clamped cubic with full knots and increasing arc lengths."""
    knots, points = np.array(document["knots"]), np.array(document["control_points"])
    assert points.ndim == 2
    assert points.shape[1] == 3
    assert len(knots) == len(points) + 4
    assert (np.diff(knots) >= 0).all()
    assert len(set(knots[:4])) == len(set(knots[-4:])) == 1
    s = document["confidence"]["s"]
    assert (s[0], s[-1]) == (0, 1)
    assert (np.diff(s) > 0).all()
    curve = BSpline(knots, points, document["degree"])(np.linspace(knots[0], knots[-1], 5000))
    assert np.linalg.norm(np.diff(curve, axis=0), axis=1).sum() == pytest.approx(document["length"], rel=1e-4)


def written(path: Path) -> dict[str, Any]:
    def refuse(constant: str) -> float:
        raise AssertionError(f"{constant} is no JSON")

    return json.loads(path.read_text(), parse_constant=refuse)


def test_a_thread_is_written_as_the_contract_says(suturegrasp, pair, small: Path) -> None:
    assert suturegrasp(*pair(small), "--output", small / "out.json").status == 0
    document = written(small / "out.json")
    check_contract(document)
    check_curve(document)
    assert document["status"] == "ok"
    assert document["unit"] == "mm"
    assert document["observations"] >= 4
    assert document["segmenter"] in ("threshold", "network")
    assert all(document["timings_ms"][step] > 0 for step in ("segment", "match", "reconstruct"))


def test_a_failure_is_written_as_the_contract_says(suturegrasp, pair, small: Path) -> None:
    for name in ("left.png", "right.png"):
        cv2.imwrite(str(small / name), np.full((180, 320, 3), 206, np.uint8))
    ended = suturegrasp(*pair(small), "--output", small / "out.json")
    document = written(small / "out.json")
    check_contract(document)
    assert ended.status == 3
    assert ended.out == ""
    assert ended.err == f"suturegrasp: {document['reason']}\n"
    assert document["status"] == "failed"
    assert document["knots"] == document["control_points"] == document["unseen"] == document["crossings"] == []
    assert document["confidence"] == {"s": [], "value": []}
    assert document["posterior"] is None
    assert document["length"] is None


def test_given_masks_take_no_time_to_segment(suturegrasp, pair, small: Path) -> None:
    masks = ("--left-mask", small / "mask_left.png", "--right-mask", small / "mask_right.png")
    assert suturegrasp(*pair(small), *masks, "--output", small / "out.json").status == 0
    document = written(small / "out.json")
    check_contract(document)
    check_curve(document)
    assert document["timings_ms"]["segment"] == 0
    assert document["segmenter"] == "mask"


def test_an_unknown_unit_stays_unknown_and_a_given_one_is_named(suturegrasp, pair, small: Path) -> None:
    calibration = json.loads((small / "calibration.json").read_text())
    calibration["baseline"] = calibration.pop("baseline_mm")
    (small / "calibration.json").write_text(json.dumps(calibration))
    assert suturegrasp(*pair(small), "--output", small / "out.json").status == 0
    document = written(small / "out.json")
    check_contract(document)
    assert document["unit"] is None
    assert "unit_unknown" in [judgement["code"] for judgement in document["judgements"]]
    assert suturegrasp(*pair(small), "--unit", "cm", "--output", small / "cm.json").status == 0
    assert written(small / "cm.json")["unit"] == "cm"


def test_two_runs_agree_in_everything_but_their_timings(suturegrasp, pair, small: Path) -> None:
    documents: list[dict[str, Any]] = []
    for name in ("first.json", "second.json"):
        assert suturegrasp(*pair(small), "--output", small / name).status == 0
        documents.append(written(small / name))
        del documents[-1]["timings_ms"]
    assert documents[0] == documents[1]
