"""What follows from how the two images lie to each other: rows, rotation, magnification, which is left, distances."""

from agents.perception.judging.answers import Answer, judgements, untold, well, wrong
from agents.perception.judging.correspondence import Correspondence
from schemas.messages import Judgement, RectifiedStereo, Severity
from shared.disparities import endoscope_disparity_px

NO_DISPARITY_PX = 0.5
"""A thread as far away as this disparity says is out of any instrument's reach."""
ROW_NOTE_PX, ROW_FAULT_SHARE = 1.0, 0.01
"""A row residual above the first is worth a warning; above that share of the height, rows cannot be matched."""
CERTAIN = 4.0
"""Standard deviations from none."""
MIRRORED_DEG = 90.0
NEAREST_MM, FARTHEST_MM = 10.0, 400.0
"""Where an endoscope's tissue may be: closer it is out of focus, farther it is out of reach."""
FEW_SHARE = 0.1
"""Of the places: so many may be matched wrongly."""

ROWS, ROTATION, SIZES, SIDES, DISTANCE = "rows", "rotation", "sizes of both eyes", "left and right", "distance"
NO_TEXTURE = "there is too little in common to compare, such as texture"
RECALIBRATE = "use the calibration taken with this camera and focus, or calibrate again; check any cropping"


def judge(seen: Correspondence, shape: tuple[int, ...], camera: RectifiedStereo | None = None) -> tuple[Judgement, ...]:
    """What is wrong with how a pair of images of that shape lies, each with its remedy; see `about_alignment`."""
    return judgements(about_alignment(seen, shape, camera))


def about_alignment(
    seen: Correspondence, shape: tuple[int, ...], camera: RectifiedStereo | None = None
) -> list[Answer]:
    """Every question about how two images lie to each other.

    Args:
        camera: of the rectified pair, by which distances are told; None leaves them out.
    """
    height, width = shape[:2]
    return [
        about_rows(seen, height),
        about_rotation(seen, height, width),
        about_sizes(seen, height),
        about_sides(seen),
        *([] if camera is None else [about_distance(seen, camera)]),
    ]


def about_rows(seen: Correspondence, height: int) -> Answer:
    """Whether what corresponds lies on one row."""
    if seen.row_residual_px is None:
        return untold(ROWS, NO_TEXTURE)
    residual = max(abs(seen.row_residual_px), seen.off_rows_px or 0.0)
    finding = f"what corresponds lies {residual:.1f} px apart in rows"
    if residual <= ROW_NOTE_PX:
        return well(ROWS, f"{finding}{_by_how_many(seen)}")
    if residual <= CERTAIN * (seen.row_deviation_px or 0.0):
        return untold(ROWS, f"the few places that correspond leave {seen.row_deviation_px:.1f} px of doubt")
    fault = residual > ROW_FAULT_SHARE * height
    severity = Severity.FAULT if fault else Severity.WARNING
    return wrong(
        ROWS, "row_residual", severity, f"{finding}, so the calibration does not fit these images", RECALIBRATE
    )


def about_rotation(seen: Correspondence, height: int, width: int) -> Answer:
    """Whether one eye's image is turned against the other's."""
    turned, deviation = seen.rotation_deg, seen.rotation_deviation_deg
    if seen.mirrored:
        way = "upside down" if abs(turned or 0.0) > MIRRORED_DEG else "left to right"
        finding, remedy = f"one eye's image is mirrored {way}", "turn off mirroring for one eye, or on for both"
        return wrong(ROTATION, "mirrored", Severity.FAULT, finding, f"{remedy}, at the camera or the frame grabber")
    if turned is None or deviation is None:
        return untold(ROTATION, NO_TEXTURE)
    at_border_px = abs(turned) * 0.0174533 * width / 2
    if at_border_px <= ROW_NOTE_PX or abs(turned) <= CERTAIN * deviation:
        return well(ROTATION, f"the eyes' images are turned against each other by {turned:.2f} degrees")
    finding = f"the right eye's image is turned by {turned:.1f} degrees against the left one's"
    severity = Severity.FAULT if at_border_px > ROW_FAULT_SHARE * height else Severity.WARNING
    remedy = "turn the camera head or its image back, or calibrate again as it is now"
    return wrong(ROTATION, "rotated", severity, finding, remedy)


def about_sizes(seen: Correspondence, height: int) -> Answer:
    """Whether both eyes show things equally large."""
    if seen.magnification is None or seen.magnification_deviation is None:
        return untold(SIZES, NO_TEXTURE)
    larger = seen.magnification - 1.0
    at_border_px = abs(larger) * height / 2
    if at_border_px <= ROW_NOTE_PX or abs(larger) <= CERTAIN * seen.magnification_deviation:
        return well(SIZES, f"the eyes show things equally large, to {max(abs(larger), 1e-3):.1%}")
    finding = f"the right eye shows things {abs(larger):.1%} {'larger' if larger > 0 else 'smaller'} than the left one"
    severity = Severity.FAULT if at_border_px > ROW_FAULT_SHARE * height else Severity.WARNING
    remedy = "look for zoom, cropping or scaling of one eye alone; set both alike, or calibrate again as it is now"
    return wrong(SIZES, "sizes_differ", severity, finding, remedy)


def about_sides(seen: Correspondence) -> Answer:
    """Whether the left image is the left one, by the sign of the disparities."""
    disparity = seen.disparity_px
    if disparity is None:
        return untold(SIDES, NO_TEXTURE)
    if disparity < -1.0:
        # how far depends on what of the scene is looked at, and says nothing of the cause
        finding = "left and right look exchanged: things lie further left in the left image"
        remedy = "exchange --left and --right, or the two halves of the side-by-side image"
        turned = "; if they are not exchanged, both are mirrored or upside down"
        known = seen.matches > 0
        return wrong(SIDES, "left_right_swapped", Severity.FAULT, finding, remedy + (turned if known else ""))
    if abs(disparity) <= NO_DISPARITY_PX:
        finding = "both images show everything in the same columns, as one image given twice does"
        return wrong(SIDES, "no_disparity", Severity.FAULT, finding, "give the left and the right image of one frame")
    if seen.farthest_px is not None and seen.behind_share > FEW_SHARE:
        finding = f"{seen.behind_share:.0%} of what both eyes show would lie behind infinity"
        return wrong(SIDES, "disparity_sign", Severity.WARNING, finding, RECALIBRATE)
    return well(SIDES, f"things lie {disparity:.0f} px further right in the left image")


def about_distance(seen: Correspondence, camera: RectifiedStereo) -> Answer:
    """Whether things are where an endoscope looks and perception searches."""
    if seen.nearest_px is None or seen.disparity_px is None or seen.disparity_px <= NO_DISPARITY_PX:
        return untold(DISTANCE, NO_TEXTURE if seen.disparity_px is None else "left and right are not right")
    usual = endoscope_disparity_px(camera.image_width)
    if seen.nearest_px > usual:
        finding = f"the nearest things are {seen.nearest_px:.0f} px apart, and an endoscope shows up to {usual:.0f} px"
        remedy = "if it is an endoscope, check the calibration's principal points; a rig beside the field shows so much"
        return wrong(DISTANCE, "disparity_range", Severity.WARNING, finding, remedy)
    if camera.metres_per_unit is None:
        return well(DISTANCE, f"disparities of up to {seen.nearest_px:.0f} px; the calibration has no unit for more")
    mm = 1000.0 * camera.fx_px * camera.baseline * camera.metres_per_unit / seen.disparity_px
    finding = f"most things would be {mm:.0f} mm away"
    if NEAREST_MM <= mm <= FARTHEST_MM:
        return well(DISTANCE, finding)
    remedy = "check the calibration: its baseline's unit, its principal points, and any cropping to one side"
    return wrong(DISTANCE, "distance_implausible", Severity.WARNING, f"{finding}, where no endoscope looks", remedy)


def _by_how_many(seen: Correspondence) -> str:
    return f", by {seen.matches} places" if seen.matches else ""
