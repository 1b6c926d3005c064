"""The fields that an evaluation looks at: drawn by the light renderer, or path-traced."""

from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Float64, UInt8

from agents.camera.scene_source import SceneSource, calibration_of, camera_in_mm
from agents.camera.sources import Pair
from agents.cli.lab.scenes import endoscope
from agents.simulated_trials.protocol import Laid, Protocol, scene_seed
from agents.simulator.agent import ENDOSCOPE, Simulator, SimulatorConfig
from agents.simulator.field import DEGREE, Field, field_with, starting_first
from schemas.messages import SimulatorState, StereoCalibration
from schemas.topics import SIMULATOR_STATE
from shared.rendering.centreline import Thread
from shared.rendering.path_traced.batch import Job, make, outstanding
from shared.rendering.path_traced.field import Field as TracedField
from shared.rendering.path_traced.ground import Ground
from shared.rendering.path_traced.placing import occluders
from shared.rendering.path_traced.recipe import Recipe, arranged
from shared.rendering.path_traced.solids import Solid
from shared.rendering.path_traced.splines import Curve, strand_of
from shared.rendering.render import SceneError, surface_of
from shared.rendering.surface import Surface
from shared.rendering.thread_shapes import ShapeError
from shared.rendering.tool_view import Instrument, draw_solids
from shared.runtime.agent import Output, Tick
from shared.splines import basis_matrix, clamped_uniform_knots

NEAR_MM, FAR_MM = 75.0, 110.0
TRIES = 40
IMAGES, SAMPLES, FINE = "images", 4, 4001
"""Where path-traced images lie in an evaluation's folder, and rays of each pixel for each lamp."""
BACKGROUND = {"paper": "tissue", "chicken": "rendered"}
"""What stands for the paper's backgrounds in the light renderer: drawn tissue for the print, path-traced flesh."""
COLOURS = ("violet", "blue", "green", "black")


@dataclass(frozen=True)
class Traced:
    """Of a path-traced pair: the surface in mm, the thread's dye, and what is thread or tool, left and right."""

    surface: Surface
    dye: str
    masks: Pair


@dataclass(frozen=True)
class Scenery:
    """What a thread is looked at and grasped in.

    Fields:
        simulated: the field as the simulator is told of it, without any errors.
        images: left and right before the grasp, blue first.
        field: where the simulator does not draw it itself.
        traced: what else is known of path-traced images.
    """

    simulated: SimulatorConfig
    images: Pair
    calibration: StereoCalibration
    field: Field | None = None
    traced: Traced | None = None


def scenery_of(protocol: Protocol, laid: Laid, folder: Path) -> Scenery:
    """The field of a thread, with its images; those that are path-traced are kept in the folder.

    Raises:
        SceneError: where it cannot be laid or rendered.
    """
    return light_scenery(protocol, laid) if protocol.images == "light" else traced_scenery(protocol, laid, folder)


def traced_scenery(protocol: Protocol, laid: Laid, folder: Path) -> Scenery:
    """A path-traced field, as `suturegrasp scenes render` makes it, rendered where it is not there yet.

    Raises:
        SceneError: where the scene cannot be arranged, traced or written.
    """
    job = traced_job(protocol, laid, folder)
    if outstanding([job]):
        make(job)
    left, right = (cv2.imread(str(job.folder / f"{job.name}_{side}.png")) for side in ("left", "right"))
    if left is None or right is None:
        raise SceneError(f"the images of {job.name} in {job.folder} cannot be read; delete {job.name}.json there")
    scenery = arranged(job.recipe, job.rig)
    camera = replace(scenery.field.camera, baseline=1e-3 * scenery.field.camera.baseline, metres_per_unit=1.0)
    strand = scenery.field.strands[0]
    thread = starting_first(camera, Thread(*_clamped(strand.curve), strand.radius_mm))
    simulated = SimulatorConfig(
        seed=job.recipe.seed, background="plain", distance_mm=scenery.distance_mm, camera=camera
    )
    surface = scenery.field.ground.surface
    traced = Traced(surface, strand.dye, (_mask(job, "left", left), _mask(job, "right", right)))
    return Scenery(simulated, (left, right), calibration_of(camera), field_with(thread, surface), traced)


def _mask(job: Job, side: str, image: UInt8[np.ndarray, "h w 3"]) -> UInt8[np.ndarray, "h w"]:
    """What is thread or tool in an image."""
    covered = np.zeros(image.shape[:2], np.uint8)
    for kind in ("mask", "tool"):
        path = job.folder / f"{job.name}_{kind}_{side}.png"
        read = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE) if path.is_file() else None
        covered = covered if read is None else np.maximum(covered, read)
    return covered


def traced_job(protocol: Protocol, laid: Laid, folder: Path) -> Job:
    """What is rendered for a thread, and where it goes."""
    seed = scene_seed(protocol, laid)
    recipe = Recipe(laid.config, laid.background, seed)
    name = f"{laid.config}_{laid.background}_{seed:04d}"
    return Job(folder / IMAGES, name, recipe, endoscope(ENDOSCOPE.image_width, ENDOSCOPE.image_height), SAMPLES)


def _clamped(curve: Curve) -> tuple[Float64[np.ndarray, "k"], Float64[np.ndarray, "m 3"]]:
    """The same curve as a clamped B-spline on as many spans: knots from 0 to 1, control points in mm."""
    knots = clamped_uniform_knots(len(curve.control_points), DEGREE)
    x = np.linspace(0.0, 1.0, FINE)
    points = curve.at(x * curve.spans)
    return knots, np.linalg.lstsq(basis_matrix(knots, DEGREE, x), points, rcond=None)[0]


def light_scenery(protocol: Protocol, laid: Laid) -> Scenery:
    """A field of the light renderer.

    Raises:
        SceneError: where none of the fields that are drawn for the thread fits into the view.
    """
    rng = np.random.default_rng([scene_seed(protocol, laid), 21])
    for _ in range(TRIES):
        config = str(rng.choice(("easy", "medium"))) if laid.config == "occlusion" else laid.config
        simulated = SimulatorConfig(
            seed=int(rng.integers(2**31)),
            config=config,
            background=BACKGROUND[laid.background],
            colour=str(rng.choice(COLOURS)),
            distance_mm=float(rng.uniform(NEAR_MM, FAR_MM)),
        )
        try:
            state = first_state(simulated)
        except ShapeError:
            continue
        hiding = _over(state, simulated, rng) if laid.config == "occlusion" else []
        if laid.config == "occlusion" and not hiding:
            continue
        images = _behind(SceneSource().render(state, 0), state, hiding)
        return Scenery(simulated, images, calibration_of(state.camera))
    raise SceneError(f"no {laid.name} of this seed fits into the view; use another seed")


def first_state(simulated: SimulatorConfig, field: Field | None = None) -> SimulatorState:
    """The field before anything has moved."""
    (output,) = [
        o for o in Simulator(simulated, field).step(Tick(0)) if isinstance(o, Output) and o.topic is SIMULATOR_STATE
    ]
    return output.message


def _over(state: SimulatorState, simulated: SimulatorConfig, rng: np.random.Generator) -> list[Solid]:
    """Instruments over the middle of the thread; none where no place was found."""
    camera = camera_in_mm(state.camera)
    surface = surface_of(camera, simulated.background, simulated.distance_mm, simulated.seed)
    nothing = np.zeros((1, 1), np.float32)
    ground = Ground(surface, np.zeros((1, 1, 3), np.float32), nothing, nothing)
    thread = Thread(state.knots, 1e3 * state.control_points_camera, 1e3 * state.radius_m)
    return occluders(TracedField(camera, ground, [strand_of(thread, "violet")]), rng)


def _behind(images: Pair, state: SimulatorState, hiding: list[Solid]) -> Pair:
    """The images with instruments before them."""
    if not hiding:
        return images
    camera = camera_in_mm(state.camera)
    drawn = [
        draw_solids(image, camera, hiding, Instrument(), eye_x_mm, state.seed)[0]
        for image, eye_x_mm in zip(images, (0.0, camera.baseline), strict=True)
    ]
    return drawn[0], drawn[1]
