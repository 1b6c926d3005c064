"""Tables for other programs: the same in every form, with units, confidence and covariance where they belong."""

import csv
import json
import tracemalloc

import numpy as np
import pytest

from agents.inspection.export import export
from agents.inspection.export_files import FORMATS
from agents.inspection.session import read_session
from schemas.messages import FrameStamp, Image, ImageEncoding, StereoFrame
from schemas.topics import FRAMES

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


@pytest.fixture(scope="module", params=list(FORMATS))
def exported(request, recording, tmp_path_factory):
    folder = tmp_path_factory.mktemp(request.param)
    return folder, request.param, export(recording, folder, request.param, points=11)


def test_every_table_has_its_rows_and_a_line_in_the_readme(exported):
    folder, form, told = exported
    assert told.rows == TABLES
    assert {path.name for path in folder.iterdir()} == {"README.txt", *(f"{name}.{form}" for name in TABLES)}
    readme = (folder / "README.txt").read_text()
    for name in TABLES:
        assert len(next(iter(columns(folder, name, form).values()))) == TABLES[name]
        assert f"{name}.{form}: {', '.join(columns(folder, name, form))}" in readme


def test_a_curve_is_in_metres_with_what_is_known_of_each_point(exported):
    folder, form, _ = exported
    curve = {name: values[:11] for name, values in columns(folder, "curves", form).items()}
    assert curve["s"] == pytest.approx(np.linspace(0, 1, 11))
    assert curve["x_camera_m"] == pytest.approx(np.linspace(-0.02, 0.02, 11))
    assert curve["z_camera_m"] == pytest.approx(np.full(11, 0.1))
    assert curve["confidence"] == pytest.approx(np.linspace(1, 0.5, 11))
    assert curve["seen"] == [1, 1, 0, 0, 0, 1, 1, 1, 1, 1, 1]
    assert curve["covariance_zz_m2"] == pytest.approx(1e-6 * np.linspace(1, 9, 11))
    assert curve["deviation_m"] == pytest.approx(1e-3 * np.sqrt(np.linspace(1, 9, 11)))
    assert curve["u_left_px"] == pytest.approx(np.linspace(27.5, 67.5, 11))


def test_failed_frames_have_their_reason_and_no_curve_and_commands_and_outcomes_tell_the_grasp(exported):
    folder, form, _ = exported
    frames = columns(folder, "frames", form)
    assert [n for n, status in zip(frames["frame"], frames["status"], strict=True) if status == "failed"] == [5, 6]
    assert (frames["reason"][5], frames["length_m"][5]) == ("only 5 observations", None)
    assert frames["length_m"][0] == pytest.approx(0.04)
    assert not {5, 6} & set(columns(folder, "curves", form)["frame"])
    commands, outcomes = columns(folder, "commands", form), columns(folder, "outcomes", form)
    assert commands["outcome"] == ["refused", "accepted", "accepted"]
    assert [kind for kind in outcomes["kind"] if kind != "phase_reached"] == ["accepted", "finished", "judged"]
    assert (outcomes["code"][-1], outcomes["slid_m"][-1]) == ("held", pytest.approx(0.004))


def test_times_are_whole_nanoseconds(recording, tmp_path):
    export(recording, tmp_path, "npz", 2)
    with np.load(tmp_path / "frames.npz") as frames:
        assert frames["capture_left_ns"].dtype == np.int64
        assert frames["capture_left_ns"][1] == 1_760_000_000 * 10**9 + round(1e9 / 30)


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
