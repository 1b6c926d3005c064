"""Stereo pairs with what is known of them: those of a data folder (its README says what they are), and rendered ones.

Each is run several times, by the masks and the calibration that it is handed over with. Hidden renders are clear ones
with a tool painted before them (benchmarks/hiding_tool.py).
"""

import json
import zlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from jaxtyping import Bool, Float64, UInt8

from agents.camera.image_files import read_mask, read_pair, read_side_by_side
from agents.cli.reconstruct.pipeline import Pair, PipelineResult, reconstruct_pair
from agents.reconstruction.method_names import DEFAULT_METHOD
from benchmarks.hiding_tool import hiding_shaft
from schemas.messages import StereoCalibration
from shared.arc_length import even_parameters
from shared.calibration import read_calibration
from shared.calibration.estimation.projection import rectifying
from shared.calibration.uncertainty import ERRORS
from shared.rectification import rectification
from shared.rigid_transforms import transform
from shared.splines import clamped_uniform_knots, evaluate

SIM, REAL, CLEAR, CROSSING, OCCLUSION, HIDDEN = (
    "ucsd sim",
    "ucsd real",
    "clear render",
    "crossing render",
    "occlusion render",
    "hidden render",
)
SHOWN_RENDERS = (CLEAR, CROSSING, OCCLUSION)
RENDERS = (*SHOWN_RENDERS, HIDDEN)
TRUTH_SAMPLES = 2000
HIDDEN_SCENES = 20
GREY_SIM, GREY_REAL = 200, 250
"""Pixels darker than these are the thread of the published scenes, on grey and on white."""


@dataclass(frozen=True)
class TrueThread:
    """Points evenly spaced along a thread, in the left camera, and whether the left and the right image shows each."""

    points: Float64[np.ndarray, "n 3"]
    visible: Bool[np.ndarray, "n 2"]


@dataclass(frozen=True)
class Scene:
    """A stereo pair with what is known of it.

    Fields:
        group: the kind of scene, as the table of goals tells them apart.
        masks: coverage by thread, as nearly true as is known, for evaluation; None where there is no thread.
        masks_are: where the masks come from.
        threads: true ones; none where they are unknown, or where there is none.
    """

    group: str
    name: str
    images: Pair
    calibration: StereoCalibration
    masks: Pair | None = None
    masks_are: str = ""
    threads: tuple[TrueThread, ...] = ()


Loader = Callable[[], Scene]


def reconstructed(
    scene: Scene, masks: Pair | None = None, segmenter: str | None = None, method: str = DEFAULT_METHOD
) -> PipelineResult:
    """What perception and reconstruction make of a scene, segmented where no masks are given."""
    return reconstruct_pair(scene.images, scene.calibration, masks=masks, segmenter=segmenter, method=method)


def scenes(data: Path) -> Iterator[tuple[str, str, Loader]]:
    """All scenes under a data folder: name, group, and a function that loads it."""
    ucsd, renders = data / "ucsd_thread", data / "renders"
    for path in sorted((ucsd / "sim").glob("scene_*.npy")):
        yield f"{SIM} {path.stem[6:]}", SIM, lambda path=path: _ucsd_sim(path)
    for path in sorted((ucsd / "real").glob("*_left.png")):
        yield f"{REAL} {path.stem[:-5]}", REAL, lambda path=path: _ucsd_real(path)
    clear: list[tuple[str, Loader]] = []
    for path in sorted(renders.glob("*.json")):
        kind, load = _kind(json.loads(path.read_text())), lambda path=path: rendered(path)
        clear += [(path.stem, load)] if kind == CLEAR else []
        yield f"{kind} {path.stem}", kind, load
    for count in range(HIDDEN_SCENES if clear else 0):
        (name, load), again = clear[count % len(clear)], count // len(clear)
        yield f"{HIDDEN} {name}_{again}", HIDDEN, lambda load=load, again=again: hidden(load(), again)


def rendered(path: Path) -> Scene:
    """A pair that `suturegrasp scenes render` wrote, or one of the published renders, by its NAME.json."""
    about = json.loads(path.read_text())
    images = read_pair(*(path.with_name(f"{path.stem}_{eye}.png") for eye in ("left", "right")))
    names = [path.stem, *(f"{path.stem}_thread{k + 2}" for k in range(len(about.get("other_threads", ()))))]
    tables = [np.load(path.with_name(f"{name}.npy")) for name in names] if about.get("threads", 1) else []
    masks = [
        read_mask(path.with_name(f"{path.stem}_mask_{eye}.png"), "the mask", about["width"], about["height"])
        for eye in (("left", "right") if tables else ())
    ]
    return Scene(
        group=_kind(about),
        name=path.stem,
        images=images,
        calibration=exact(_calibration_of_render(about)),
        masks=(masks[0], masks[1]) if masks else None,
        masks_are="true",
        threads=tuple(TrueThread(table[:, :3].astype(np.float64), table[:, 4:] > 0) for table in tables),
    )


def hidden(scene: Scene, again: int) -> Scene:
    """The scene with a tool in front of it that hides a third of the thread, another one for each `again`."""
    name = f"{scene.name}_{again}"
    (thread,) = scene.threads
    assert scene.masks is not None
    camera = rectification(scene.calibration).camera
    shaft = hiding_shaft(camera, thread.points, thread.visible, zlib.crc32(name.encode()))
    images, masks = shaft.painted(scene.images, scene.masks)
    still = TrueThread(thread.points, thread.visible & ~shaft.hides(camera, thread.points))
    return replace(scene, group=HIDDEN, name=name, images=images, masks=masks, threads=(still,))


def exact(calibration: StereoCalibration) -> StereoCalibration:
    """The calibration of a camera that draws its images by it."""
    return replace(calibration, covariance=np.zeros((len(ERRORS), len(ERRORS))))


def _kind(about: dict[str, Any]) -> str:
    # renders of `suturegrasp scenes render` do not count their crossings
    if about.get("crossings_left", about["config"] == "crossing"):
        return CROSSING
    return OCCLUSION if about["config"] == "occlusion" else CLEAR


def _calibration_of_render(about: dict[str, Any]) -> StereoCalibration:
    """In millimetres; both eyes are alike where nothing is said of the right one."""
    K, none = np.array(about["K"]), np.zeros(0)
    shift = np.ravel(about.get("t_right_left_mm", (-about["baseline_mm"], 0.0, 0.0)))
    return StereoCalibration(
        image_width=about["width"],
        image_height=about["height"],
        K_left=K,
        K_right=np.array(about.get("K_right", K)),
        distortion_left=np.array(about.get("distortion_left", none), np.float64),
        distortion_right=np.array(about.get("distortion_right", none), np.float64),
        T_right_left=transform(np.array(about.get("R_right_left", np.eye(3))), shift),
        metres_per_unit=1e-3,
    )


def _ucsd_sim(path: Path) -> Scene:
    name = path.stem[6:]
    image = next(p for p in path.parent.glob(f"{path.stem}.*") if p.suffix in (".png", ".jpg"))
    images = read_side_by_side(image)
    calibration = "calibration_scenes_1_3.yaml" if name[0] in "13" else "calibration_scenes_5_7_9.yaml"
    control_points = np.load(path)
    knots = clamped_uniform_knots(len(control_points))
    truth = evaluate(knots, control_points, 3, even_parameters(knots, control_points, 3, TRUTH_SAMPLES))
    return Scene(
        group=SIM,
        name=name,
        images=images,
        calibration=exact(_calibration(path.with_name(calibration), images, None)),
        masks=_darker_than(images, GREY_SIM),
        masks_are=f"grey<{GREY_SIM}",
        threads=(TrueThread(truth, np.ones((len(truth), 2), bool)),),
    )


def _ucsd_real(path: Path) -> Scene:
    images = read_pair(path, path.with_name(path.name.replace("_left", "_right")))
    calibration = _calibration(path.with_name("calibration.yaml"), images, "mm")
    return Scene(REAL, path.stem[:-5], images, calibration, _darker_than(images, GREY_REAL), f"grey<{GREY_REAL}")


def _calibration(path: Path, images: Pair, unit: str | None) -> StereoCalibration:
    height, width = images[0].shape[:2]
    return read_calibration(path, unit=unit, image_size=(width, height)).calibration


def _darker_than(images: Pair, grey: int) -> Pair:
    def mask(image: UInt8[np.ndarray, "h w 3"]) -> UInt8[np.ndarray, "h w"]:
        return np.where(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY) < grey, 255, 0).astype(np.uint8)

    return mask(images[0]), mask(images[1])


NONE, BINARY = "none", "binary"
SEGMENTED = 128
FOCAL_SHARE, ROWS_PX, TURN_DEG = 1e-3, 0.3, 0.1
AXES = {"x": (1.0, 0.0, 0.0), "y": (0.0, 1.0, 0.0), "z": (0.0, 0.0, 1.0)}


@dataclass(frozen=True)
class Run:
    """A scene, as it is handed over, with the masks to be used for it.

    Fields:
        masks: None where the images have to be segmented.
        masks_are: `none` then, otherwise where they come from.
        calibration_is: what is wrong with the scene's calibration, empty where nothing is.
        R_rectified_camera: how rectification by that turns the left camera, and so the result against the truth.
    """

    scene: Scene
    masks: Pair | None = None
    masks_are: str = NONE
    calibration_is: str = ""
    R_rectified_camera: Float64[np.ndarray, "3 3"] | None = None


def runs(scene: Scene) -> Iterator[Run]:
    """Every way in which a scene is run."""
    if scene.group != HIDDEN:
        yield Run(scene)
    yield Run(scene, scene.masks, scene.masks_are)
    if scene.group != CLEAR:
        return
    assert scene.masks is not None
    binary = [np.where(mask >= SEGMENTED, 255, 0).astype(np.uint8) for mask in scene.masks]
    yield Run(scene, (binary[0], binary[1]), BINARY)
    for name, wrong in wrong_calibrations(scene.calibration):
        yield Run(replace(scene, calibration=wrong), scene.masks, scene.masks_are, name, rectifying(wrong)[0])


def wrong_calibrations(calibration: StereoCalibration) -> Iterator[tuple[str, StereoCalibration]]:
    """The calibration with one error each, of the size that a careful calibration still has."""
    calibration = replace(calibration, covariance=None)
    focal = np.diag([1.0 + FOCAL_SHARE, 1.0 + FOCAL_SHARE, 1.0])
    # K diag(k, k, 1) scales the focal lengths and leaves the principal point
    yield "f 0.1 %", replace(calibration, K_left=calibration.K_left @ focal, K_right=calibration.K_right @ focal)
    rows = np.array(calibration.K_right)
    rows[1, 2] += ROWS_PX
    yield "rows 0.3 px", replace(calibration, K_right=rows)
    for axis, direction in AXES.items():
        turned = np.array(calibration.T_right_left)
        turned[:3, :3] = cv2.Rodrigues(np.radians(TURN_DEG) * np.array(direction))[0] @ turned[:3, :3]
        yield f"{axis} 0.1°", replace(calibration, T_right_left=turned)
