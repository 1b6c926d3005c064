"""`suturegrasp calibrate stereo | check`: a calibration from views of a board, and what one is worth."""

from pathlib import Path

import numpy as np

from agents.cli.calibrate.options import Calibrate
from agents.cli.calibrate.page import write_report
from agents.cli.calibrate.views import Seen, views_in_folders, views_of_camera
from agents.cli.places import check_folder
from agents.configuration.rig import RigConfig
from agents.launch.process import EXIT_OK, stopping
from schemas.messages import Judgement, Severity
from shared.calibration import CalibrationError, read_calibration, write_calibration
from shared.calibration.estimation.board import Board
from shared.calibration.estimation.checking import Checked, checked, held_out
from shared.calibration.estimation.coverage import coverage, lacking
from shared.calibration.estimation.estimate import FEWEST_VIEWS, Estimate, estimated
from shared.calibration.judge import judgements
from shared.calibration.own_file import camera_info_texts, opencv_text
from shared.calibration.uncertainty import FIELD_DEPTHS, bending, covariance_of, displacements
from shared.clock import now_ns
from shared.rectification import rectification
from shared.runtime.connection import connected
from shared.terminal import UsageError, complain, say, warn
from shared.units import METRES_PER_UNIT

EXIT_WRONG, EXIT_NONE = 1, 3
ROWS_LIMIT_PX, SQUARES_LIMIT = 0.5, 0.01
"""A calibration is good where corners lie that close to one row (median), and squares are as large as they are."""


def calibrate(rig: RigConfig, options: Calibrate) -> int:
    """Carry it out; the exit status."""
    board = Board(*options.squares, options.square, options.marker, options.dictionary, options.legacy)
    if options.action == "check":
        return _check(options, board)
    try:
        return _estimate(rig, options, board)
    except CalibrationError as error:
        return complain(str(error), EXIT_NONE)


def _estimate(rig: RigConfig, options: Calibrate, board: Board) -> int:
    if options.calibration:
        raise UsageError("stereo makes a calibration; to check one, say calibrate check")
    if options.views < FEWEST_VIEWS:
        raise UsageError(f"--views {options.views}: give {FEWEST_VIEWS} or more, better 20")
    output = _output(options.output)
    seen = _live(rig, options, board, output) if options.live else views_in_folders(options, board)
    for sentence in lacking(coverage(seen.views, board, seen.image_size)):
        warn(sentence)
    estimate = estimated(seen.views, board, seen.image_size, METRES_PER_UNIT[options.unit])
    for name, px in estimate.left_out:
        warn(f"{name} contradicts the other views by {px:.1f} px and was left out: did the board move, or bend?")
    judged = judgements(estimate.calibration)
    for judgement in judged:
        if judgement.severity is Severity.FAULT:
            raise CalibrationError(f"no calibration was written: {_unlike_eyes(judgement)}")
    apart = held_out(estimate.views, board, seen.image_size, METRES_PER_UNIT[options.unit])
    _write(output, estimate)
    report = write_report(output, board, seen, estimate, apart)
    for sentence in _told(estimate, apart, options.unit):
        say(sentence)
    for judgement in judged:
        warn(f"{judgement.finding} {judgement.remedy}")
    if apart and _rows(apart) > ROWS_LIMIT_PX:
        warn(f"rows are off by more than {ROWS_LIMIT_PX} px on views held out; take sharper and more varied views")
    say(f"calibration.json, opencv.yaml and ros/ in {output}; report: {report}")
    return EXIT_OK


def _unlike_eyes(fault: Judgement) -> str:
    """What is wrong with images of which a calibration with such a fault was made, and what to do."""
    if fault.code == "left_and_right_swapped":
        return "left and right look exchanged; give them the other way round, or, if they are not, turn off mirroring"
    return f"{fault.finding} {fault.remedy}"


def _live(rig: RigConfig, options: Calibrate, board: Board, output: Path) -> Seen:
    if any((options.left, options.right, options.stereo)):
        raise UsageError("--live takes frames of the camera; leave --left, --right and --stereo out")
    stopped = stopping()
    say("show the board to both eyes, and move it to where the lines below say; Ctrl-C ends it with what there is")
    with connected(rig.session) as connection:
        seen = views_of_camera(connection, board, output, options.views, stopped)
    if seen is None:
        raise UsageError("no frame came from the rig's camera; start it with suturegrasp up, or suturegrasp run camera")
    return seen


def _check(options: Calibrate, board: Board) -> int:
    if options.live or options.output is not None:
        raise UsageError("check reads images from folders and writes nothing; leave --live and --output out")
    if not 1 <= len(options.calibration) <= 2:
        raise UsageError("give the --calibration that is to be checked: one path, or two (left and right)")
    seen = views_in_folders(options, board)
    read = read_calibration(options.calibration, unit=options.unit, image_size=seen.image_size)
    if not seen.views:
        raise UsageError("no image shows the board to both eyes; check --squares, and that all of it is in view")
    found = [checked(view, board, read.calibration) for view in seen.views]
    for one in found:
        say(
            f"{one.view.name}: rows {np.median(np.abs(one.rows_px)):.2f} px apart (median), "
            f"{np.abs(one.rows_px).max():.2f} px (most); squares {one.size - 1:+.2%} (each {one.squares.std():.1%}); "
            f"reprojection {one.rms_px:.2f} px"
        )
    rows, size = _rows(found), max(abs(one.size - 1) for one in found)
    wrong = [f"rows are {rows:.2f} px apart"] if rows > ROWS_LIMIT_PX else []
    wrong += [f"squares are off by {size:.1%}"] if size > SQUARES_LIMIT else []
    if wrong:
        return complain(f"{' and '.join(wrong)}: calibrate again, or check --square", EXIT_WRONG)
    say(f"rows are {rows:.2f} px apart (median), and squares are right to {size:.2%}")
    return EXIT_OK


def _output(folder: Path | None) -> Path:
    if folder is None:
        raise UsageError("give --output, a folder for the calibration and its report")
    check_folder("--output", folder)
    folder.mkdir(parents=True, exist_ok=True)
    return folder


def _write(output: Path, estimate: Estimate) -> None:
    made_ns = now_ns()
    write_calibration(output / "calibration.json", estimate.calibration, made_ns)
    (output / "opencv.yaml").write_text(opencv_text(estimate.calibration, made_ns), encoding="utf-8")
    (output / "ros").mkdir(exist_ok=True)
    for side, text in zip(("left", "right"), camera_info_texts(estimate.calibration), strict=True):
        (output / "ros" / f"{side}.yaml").write_text(text, encoding="utf-8")


def _told(estimate: Estimate, apart: tuple[Checked, ...], unit: str) -> list[str]:
    calibration = estimate.calibration
    baseline = float(np.linalg.norm(calibration.T_right_left[:3, 3]))
    per_view = estimate.view_rms_px
    told = [
        f"{len(estimate.views)} views: focal lengths {calibration.K_left[0, 0]:.1f} and "
        f"{calibration.K_right[0, 0]:.1f} px, baseline {baseline:.3f} {unit}",
        f"reprojection: {np.median(per_view):.2f} px (median view), {per_view.max():.2f} px (worst)",
        _depth(estimate, unit),
    ]
    if not apart:
        return [*told, "nothing could be held out: with two more views than the least, error on new views is told too"]
    size = max(abs(one.size - 1) for one in apart)
    held = float(np.median([one.rms_px for one in apart]))
    return [
        *told,
        f"on views held out: reprojection {held:.2f} px (median), rows {_rows(apart):.2f} px apart (median), "
        f"squares right to {size:.2%} in the worst view",
    ]


def _depth(estimate: Estimate, unit: str) -> str:
    """How well depth is known in the middle of the image, where the boards stood."""
    calibration, distance = estimate.calibration, float(np.median(estimate.T_left_board[:, 2, 3]))
    camera, middle = rectification(calibration).camera, np.array([[0.0, 0.0, distance]])
    near = middle * np.array(FIELD_DEPTHS)[:, None]
    whole, bent = (
        np.sqrt(float((moved[:, 2] @ covariance_of(calibration) * moved[:, 2]).sum(axis=1).max()))
        for moved in (displacements(camera, middle), bending(camera, near, distance))
    )
    return (
        f"depth at {distance:.3g} {unit}: known to {whole:.2g} {unit} (one deviation), and to {bent:.2g} {unit} by a "
        "robot whose hand-eye transform is found with it"
    )


def _rows(found: tuple[Checked, ...] | list[Checked]) -> float:
    return float(np.median(np.abs(np.concatenate([one.rows_px for one in found]))))
