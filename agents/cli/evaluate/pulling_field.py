"""A drawn stitch for one trial of pulling: its physics, how it looks, and what perception and reconstruction see."""

from functools import cached_property

import numpy as np
from jaxtyping import Float64, UInt8

from agents.camera.agent import CameraConfig, FrameSender
from agents.camera.scene_source import calibration_of, camera_in_mm
from agents.camera.sources import Pair
from agents.cli.evaluate.scenes import COLOURS, FAR_MM, NEAR_MM
from agents.configuration.rig import RigConfig
from agents.launch.builders import build
from agents.simulated_trials.look import Look, fed
from agents.simulated_trials.pulling.driving import ArmState
from agents.simulated_trials.pulling.protocol import PullProtocol, PullTrial, error_seed, field_seed
from agents.simulator.agent import ENDOSCOPE
from agents.simulator.contact.world import Pose
from agents.simulator.field import MM
from agents.simulator.pulling.world import Pulled, PullWorld
from agents.simulator.world import hand_eye_error, tool_error
from schemas.messages import ImageEncoding
from schemas.topics import CALIBRATION, FRAMES, OBSERVATIONS, THREAD
from shared.kinematics.simulated_setup import SIMULATED_BASES
from shared.rendering.backdrop_files import Backdrop
from shared.rendering.render import SceneError, render_backdrop, surface_of
from shared.rendering.sensor import Sensor, expose, grain
from shared.rendering.stitches import Stitch, render_strands, stitch_on, strand_thread
from shared.rendering.surface import Surface
from shared.rendering.thread_shapes import ShapeError
from shared.rendering.tool_view import Instrument, draw_solids, solids_of
from shared.rigid_transforms import inverse
from shared.runtime.agent import Output

ARM = "psm1"
BACKGROUNDS = ("tissue", "rendered")
TRIES = 40
GRAIN_MARGIN_PX = 64


class PullField:
    """A stitch with all that is true of it; lengths are millimetres, poses of the arm in metres.

    Fields:
        stitch, surface: as drawn; `world`: the thread in them.
        T_camera_base: where the arm stands, as registered.
    """

    def __init__(self, protocol: PullProtocol, trial: PullTrial) -> None:
        """Draw the stitch.

        Raises:
            SceneError: where none fits into the view.
        """
        self.camera = camera_in_mm(ENDOSCOPE)
        self._instrument, self._seed = protocol.instrument, field_seed(protocol, trial)
        self.stitch, self.surface = self._drawn(np.random.default_rng([self._seed, 41]))
        self.world = PullWorld(self.stitch, self.surface)
        self.T_camera_base = np.array(SIMULATED_BASES[ARM])
        seed, middle = error_seed(protocol, trial), MM * self.stitch.holes.mean(axis=0)
        self._hand_eye = hand_eye_error(seed, ARM, protocol.hand_eye_mm, protocol.hand_eye_deg, middle)
        self._tool_offset = tool_error(seed, ARM, "", 0, protocol.tool_error_mm).offset_camera
        self._frames = 0

    def _drawn(self, rng: np.random.Generator) -> tuple[Stitch, Surface]:
        for _ in range(TRIES):
            self.colour, self._background = str(rng.choice(COLOURS)), str(rng.choice(BACKGROUNDS))
            self._distance_mm, self._field_seed = float(rng.uniform(NEAR_MM, FAR_MM)), int(rng.integers(2**31))
            surface = surface_of(self.camera, self._background, self._distance_mm, self._field_seed)
            try:
                return stitch_on(self.camera, surface, int(rng.integers(2**31))), surface
            except ShapeError:
                continue
        raise SceneError("no stitch of this trial fits into the view; use another seed")

    def move(self, arm: ArmState, elapsed_s: float) -> Pulled:
        """Bring the tool to where the arm truly is when it is measured there."""
        T = self._true(arm.T_camera_tool)
        T[:3, 3] /= MM
        return self.world.move(Pose(T, arm.jaw_rad), elapsed_s)

    def images(self, arm: ArmState) -> Pair:
        """What both eyes see now, blue first."""
        state, radius = self.world.state, self.stitch.radius_mm
        shown = [points for points in (state.tail, state.standing) if len(points)]
        strands = tuple(strand_thread(points, radius) for points in shown)
        holes = self.stitch.holes if state.out else np.array([points[0] for points in shown])
        left, right = render_strands(self.camera, strands, holes, radius, self.colour, self._backdrop)
        if self._instrument:
            left, right = self._with_instrument((left, right), arm)
        shape, place = (
            left.shape[:2],
            np.random.default_rng([self._seed, self._frames]).integers(GRAIN_MARGIN_PX, size=4),
        )
        self._frames += 1
        cut = [self._grain[y : y + shape[0], x : x + shape[1]] for y, x in (place[:2], place[2:])]
        return expose(left, Sensor(), cut[0]), expose(right, Sensor(), cut[1])

    def _with_instrument(self, images: Pair, arm: ArmState) -> Pair:
        tool = Instrument()
        T_base_tool = inverse(self.T_camera_base) @ self._true(arm.T_camera_tool)
        solids = solids_of(self.T_camera_base, T_base_tool, arm.jaw_rad, tool)
        eyes = (0.0, self.camera.baseline)
        left, right = (
            draw_solids(image, self.camera, solids, tool, x, 0)[0] for image, x in zip(images, eyes, strict=True)
        )
        return left, right

    def _true(self, T_camera_tool: Float64[np.ndarray, "4 4"]) -> Float64[np.ndarray, "4 4"]:
        T = self._hand_eye @ T_camera_tool
        T[:3, 3] += self._tool_offset
        return T

    @cached_property
    def _backdrop(self) -> Backdrop:
        return render_backdrop(self.camera, self._background, self._distance_mm, self._field_seed)

    @cached_property
    def _grain(self) -> UInt8[np.ndarray, "h w 3"]:
        shape = (self.camera.image_height + GRAIN_MARGIN_PX, self.camera.image_width + GRAIN_MARGIN_PX)
        return grain(shape, self._field_seed)


class Eyes:
    """Perception and reconstruction of a rig, which follow the thread from frame to frame."""

    def __init__(self, rig: RigConfig, began_ns: int = 0) -> None:
        self._perception, self._reconstruction = build(rig, "perception", "main"), build(rig, "reconstruction", "main")
        self._calibration, self._began_ns = calibration_of(ENDOSCOPE), began_ns
        self._sender = FrameSender(CameraConfig(encoding=ImageEncoding.RAW))
        self._sender.calibrated(self._calibration)
        fed(self._perception, CALIBRATION, self._calibration)

    def look(self, images: Pair, at_s: float) -> Look:
        """What they say of images that were taken then."""
        frame = self._sender.frame(images, self._began_ns + round(1e9 * at_s))
        said = [Output(CALIBRATION, self._calibration), Output(FRAMES, frame)]
        for output in fed(self._perception, FRAMES, frame):
            said.append(output)
            if output.topic is OBSERVATIONS:
                said += fed(self._reconstruction, OBSERVATIONS, output.message)
        # perception may tell of the surface after it has told of the thread
        said.sort(key=lambda output: output.topic is THREAD)
        fed(self._perception, THREAD, said[-1].message)
        return Look(tuple(said), said[-1].message)
