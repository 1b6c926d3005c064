"""The JSON of `suturegrasp reconstruct`, field by field."""

import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from scipy.interpolate import BSpline


def check_contract(document: dict[str, Any]) -> None:
    """What holds for every result, whatever its status."""
    assert (document["reason"] is None) == (document["status"] == "ok")
    assert document["frame"] == "left rectified camera"
    assert document["degree"] == 3
    assert {"rectify", "segment", "match", "reconstruct"} <= set(document["timings_ms"])
    assert all(ms >= 0 for ms in document["timings_ms"].values())
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


def test_a_thread_is_written_as_the_contract_says_and_alike_each_time(suturegrasp, pair, small: Path) -> None:
    documents: list[dict[str, Any]] = []
    for name in ("first.json", "second.json"):
        assert suturegrasp(*pair(small), "--output", small / name).status == 0
        documents.append(written(small / name))
        check_contract(documents[-1])
        check_curve(documents[-1])
        timings_ms = documents[-1].pop("timings_ms")
        assert all(timings_ms[step] > 0 for step in ("segment", "match", "reconstruct"))
    first, second = documents
    assert first == second
    assert (first["status"], first["unit"]) == ("ok", "mm")
    assert first["observations"] >= 4
    assert first["segmenter"] in ("threshold", "network")


def test_a_failure_is_written_as_the_contract_says_with_its_picture_and_recording(suturegrasp, pair, small: Path):
    for name in ("left.png", "right.png"):
        cv2.imwrite(str(small / name), np.full((180, 320, 3), 206, np.uint8))
    shown = ("--picture", small / "out.jpg", "--rrd", small / "out.rrd")
    ended = suturegrasp(*pair(small), "--output", small / "out.json", *shown)
    document = written(small / "out.json")
    check_contract(document)
    assert (ended.status, ended.out, ended.err) == (3, "", f"suturegrasp: {document['reason']}\n")
    assert document["status"] == "failed"
    assert document["knots"] == document["control_points"] == document["unseen"] == document["crossings"] == []
    assert document["confidence"] == {"s": [], "value": []}
    assert document["posterior"] is document["length"] is None
    assert (small / "out.jpg").stat().st_size > 0
    assert (small / "out.rrd").read_bytes()[:3] == b"RRF"


def test_given_masks_of_either_form_take_no_time_to_segment(suturegrasp, pair, small: Path) -> None:
    masks = {side: small / f"mask_{side}.png" for side in ("left", "right")}
    whole = {side: cv2.imread(str(path), cv2.IMREAD_GRAYSCALE) for side, path in masks.items()}
    found: list[list[list[float]]] = []
    for white in (np.uint8(255), np.uint16(1)):
        for side, path in masks.items():
            mask = whole[side]
            assert mask is not None
            cv2.imwrite(str(path), (mask >= 128) * white)
        options = ("--left-mask", masks["left"], "--right-mask", masks["right"], "--output", small / "out.json")
        assert suturegrasp(*pair(small), *options).status == 0
        document = written(small / "out.json")
        check_contract(document)
        check_curve(document)
        assert (document["timings_ms"]["segment"], document["segmenter"]) == (0, "mask")
        found.append(document["control_points"])
    assert found[0] == found[1]


def test_an_unknown_unit_stays_unknown_and_a_given_one_is_named(suturegrasp, pair, small: Path) -> None:
    calibration = json.loads((small / "calibration.json").read_text())
    calibration["baseline"] = calibration.pop("baseline_mm")
    (small / "calibration.json").write_text(json.dumps(calibration))
    assert suturegrasp(*pair(small), "--output", small / "out.json").status == 0
    document = written(small / "out.json")
    assert document["unit"] is None
    assert "unit_unknown" in [judgement["code"] for judgement in document["judgements"]]
    assert suturegrasp(*pair(small), "--unit", "cm", "--output", small / "cm.json").status == 0
    assert written(small / "cm.json")["unit"] == "cm"
