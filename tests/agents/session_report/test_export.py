"""Tables for other programs: the same in every form, with units, confidence and covariance where they belong."""

import csv
import json
import tracemalloc

import numpy as np
import pytest

from agents.session_report.export import FORMATS, export
from agents.session_report.session import read_session
from schemas.messages import FrameStamp, Image, ImageEncoding, StereoFrame
from schemas.topics import FRAMES
from tests.agents.session_report.conftest import ns

TABLES = {"frames": 57, "curves": 55 * 11, "plans": 1, "waypoints": 2, "robot_states": 57, "commands": 3, "outcomes": 8}


def columns(folder, name, form):
    """The columns of a table as lists of text or numbers, None for what is not known."""
    path = folder / f"{name}.{form}"
    if form == "csv":
        with path.open(newline="") as file:
            rows = list(csv.reader(file))
        return {column: [parsed(row[i]) for row in rows[1:]] for i, column in enumerate(rows[0])}
    if form == "json":
        table = json.loads(path.read_text())
        return {column: [row[i] for row in table["rows"]] for i, column in enumerate(table["columns"])}
    with np.load(path) as arrays:
        values = {name: arrays[name].tolist() for name in arrays.files}
    return {name: [None if value != value else value for value in column] for name, column in values.items()}


def parsed(cell):
    try:
        return float(cell) if cell else None
    except ValueError:
        return cell


@pytest.mark.parametrize("form", FORMATS)
def test_every_table_says_what_was_recorded_and_has_a_line_in_the_readme(recording, tmp_path, form):
    assert export(recording, tmp_path, form, points=11).rows == TABLES
    assert {path.name for path in tmp_path.iterdir()} == {"README.txt", *(f"{name}.{form}" for name in TABLES)}
    tables = {name: columns(tmp_path, name, form) for name in TABLES}
    readme = (tmp_path / "README.txt").read_text()
    for name, table in tables.items():
        assert {len(column) for column in table.values()} == {TABLES[name]}
        assert f"{name}.{form}: {', '.join(table)}" in readme

    curve = {name: values[:11] for name, values in tables["curves"].items()}
    for name, expected in (
        ("s", np.linspace(0, 1, 11)),
        ("x_camera_m", np.linspace(-0.02, 0.02, 11)),
        ("z_camera_m", np.full(11, 0.1)),
        ("confidence", np.linspace(1, 0.5, 11)),
        ("covariance_zz_m2", 1e-6 * np.linspace(1, 9, 11)),
        ("deviation_m", 1e-3 * np.sqrt(np.linspace(1, 9, 11))),
        ("u_left_px", np.linspace(27.5, 67.5, 11)),
    ):
        assert curve[name] == pytest.approx(expected)
    assert curve["seen"] == [1, 1, 0, 0, 0, 1, 1, 1, 1, 1, 1]

    # failed frames have their reason and no curve
    frames = tables["frames"]
    assert [n for n, status in zip(frames["frame"], frames["status"], strict=True) if status == "failed"] == [5, 6]
    assert (frames["reason"][5], frames["length_m"][5]) == ("only 5 observations", None)
    assert frames["length_m"][0] == pytest.approx(0.04)
    assert not {5, 6} & set(tables["curves"]["frame"])
    if form == "npz":
        assert frames["capture_left_ns"][1] == ns(1 / 30)

    commands, outcomes = tables["commands"], tables["outcomes"]
    assert commands["outcome"] == ["refused", "accepted", "accepted"]
    assert [kind for kind in outcomes["kind"] if kind != "phase_reached"] == ["accepted", "finished", "judged"]
    assert (outcomes["code"][-1], outcomes["slid_m"][-1]) == ("held", pytest.approx(0.004))


def test_lengths_whose_unit_nobody_knows_are_named_so(a_session, tmp_path):
    path = a_session(frames=10, unit=None).write(tmp_path / "a.mcap")
    (tmp_path / "out").mkdir()
    export(path, tmp_path / "out", "csv", 2)
    curves = columns(tmp_path / "out", "curves", "csv")
    assert curves["x_camera_unit"][:2] == [-20, 20]
    assert "x_camera_m" not in curves


def test_images_pass_through_and_do_not_stay_in_memory(maker, tmp_path):
    from_camera = Image(ImageEncoding.RAW, 640, 360, 3, bytes(640 * 360 * 3))
    for number in range(40):
        stamp = FrameStamp(number, number, number, "c")
        maker.put(FRAMES, StereoFrame(stamp, from_camera, from_camera), number / 30)
    path = maker.write(tmp_path / "large.mcap")
    maker.entries.clear()
    (tmp_path / "out").mkdir()
    tracemalloc.start()
    try:
        assert read_session(path).contents[0].count == 40
        export(path, tmp_path / "out", "npz", 50)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    # 55 MB of images went through; one pair takes 1.4 MB, and is copied a few times on its way
    assert peak < 20e6
