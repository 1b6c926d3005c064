"""Any message of the dataflow as Rerun shows it live; the other mappings have the paths of what they show.

world/left, world/right     with `image` where the camera's images are rectified as they come
camera/raw/left, right      the images where they are not: nothing measured in rectified images fits on them
lanes/{stage}               whether a stage has a result

Of a message that says itself what it shows (`schemas/shown.py`), in millimetres:

world/shown/{agent}/{name}  curves, and places as ellipsoids of 95 %; over both images too
{agent}/{name}              figures
lanes/{agent}               its state
"""

from collections import deque
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import rerun as rr
from scipy.spatial.transform import Rotation

from agents.viewer import colours
from agents.viewer.entity import Entity, camera_in_mm, observations_in_mm, reconstruction_in_mm
from agents.viewer.grasp_mapping import (
    WeighedCaptures,
    check_entities,
    execution_entities,
    joint_names,
    judgement_entities,
    mode_entities,
    plan_entities,
    robot_numbers,
    robot_tool_entities,
    tail_entities,
    truth_entities,
)
from agents.viewer.layout import Scene
from agents.viewer.report import finding_text, findings, unit_text
from agents.viewer.seen_mapping import (
    candidate_entities,
    contact_entities,
    coverage,
    frame_entities,
    match_entities,
    occluder_entities,
    score_entities,
    surface_entities,
    tool_entities,
    verdict,
    verdict_entities,
)
from agents.viewer.session_mapping import (
    Dataflow,
    clock_entities,
    command_entities,
    configuration_entities,
    end_to_end_name,
    health_entities,
    lane,
    log_entities,
    said,
)
from agents.viewer.thread_mapping import (
    BACKDROP,
    camera_entities,
    curve_looks,
    mask_entities,
    observation_entities,
    reconstruction_entities,
)
from schemas.messages import (
    AgentConfiguration,
    AgentHealth,
    ChallengeEcho,
    CommandRecord,
    ExecutionEvent,
    FrameNotice,
    FrameStamp,
    GraspCheck,
    GraspJudgement,
    GraspPlan,
    Heartbeat,
    HostClocks,
    LogRecord,
    RectifiedStereo,
    ReplayClock,
    RightEye,
    RobotState,
    SimulatorState,
    Status,
    StereoCalibration,
    StereoFrame,
    Tail,
    ThreadObservations,
    ThreadReconstruction,
    ThreadTrack,
    TissueSurface,
    ToolCorrection,
)
from schemas.shown import Shown, Shows
from schemas.topics import TOPICS
from shared.camera import is_rectified
from shared.right_eye import IN_LINE, from_in_line, right_eye_of

SIGMAS = 2.8
"""The half-axes of an ellipsoid that holds 95 %, in standard deviations."""
RADIUS_PX = 2.0


def shown_entities(agent: str, camera: RectifiedStereo, shown: Shown, changed: bool) -> list[Entity]:
    """Entities of all that a message shows; its lane and its sentence where its state has `changed`."""
    scale = camera_in_mm(camera).baseline / camera.baseline
    path = rr.escape_entity_path_part(agent)
    entities: list[Entity] = []
    for name, points in shown.curves.items():
        curve = rr.LineStrips3D([scale * points], colors=[colours.CHOSEN], radii=[-RADIUS_PX])
        entities.append((f"world/shown/{path}/{rr.escape_entity_path_part(name)}", [curve]))
    for name, (point, covariance) in shown.places.items():
        variances, axes = np.linalg.eigh(scale**2 * covariance)
        axes[:, 0] *= np.linalg.det(axes)
        ellipsoid = rr.Ellipsoids3D(
            centers=[scale * point],
            half_sizes=[SIGMAS * np.sqrt(np.maximum(variances, 0.0))],
            quaternions=[Rotation.from_matrix(axes).as_quat()],
            colors=[colours.CHOSEN],
            labels=[name],
            show_labels=True,
        )
        entities.append((f"world/shown/{path}/{rr.escape_entity_path_part(name)}", [ellipsoid]))
    entities += [(f"{path}/{name}", [rr.Scalars(value)]) for name, value in shown.figures.items()]
    if changed and shown.state:
        entities.append(lane(path, shown.state))
    if changed and shown.sentence:
        level = rr.TextLogLevel.INFO if shown.state == "ok" else rr.TextLogLevel.WARN
        entities.append(said(agent, shown.sentence, level))
    return entities


MOST_MATCHED = 1500
"""Matched pixels shown of one frame; there are tens of thousands."""

OBSERVED_MOST = 20
"""Frames whose observations are kept until their thread comes: two seconds at the rate that is shown."""


class LiveMapping:
    """Turns messages into entities, one after the other; remembers the camera, and what has been said before.

    Fields:
        scene: what there is to be laid out, as far as is known.
    """

    def __init__(self) -> None:
        self.scene = Scene(raw_images=True)
        self._shown: tuple[RectifiedStereo, RightEye | None, float] | None = None
        self._before: dict[str, object] = {}
        self._made: dict[str, tuple[object, list[Entity]]] = {}
        self._observed: deque[ThreadObservations] = deque(maxlen=OBSERVED_MOST)
        self._considered, self._dataflow = WeighedCaptures(), Dataflow()
        self._right_eye: RightEye | None = None
        self._to_shown = IN_LINE

    def entities(self, message: object) -> list[Entity]:
        """What to log of a message.

        Raises:
            ImageDataError: where an image is none.
        """
        match message:
            case StereoFrame():
                return frame_entities(message, not self.scene.raw_images)
            case StereoCalibration():
                self.scene = replace(self.scene, raw_images=not is_rectified(message))
                return []
            case ThreadObservations():
                return self._observations(observations_in_mm(message))
            case TissueSurface():
                return surface_entities(message)
            case ToolCorrection():
                self.scene = replace(self.scene, tracked=True)
                changed = self._changed(f"tool of {message.arm}", (message.status, message.T_correction is None))
                return tool_entities(message, changed)
            case ThreadReconstruction():
                return self._reconstruction(reconstruction_in_mm(message))
            case GraspPlan():
                return [*plan_entities(message), *contact_entities(message), *self._considered.entities(message)]
            case RobotState():
                return self._robot(message)
            case ExecutionEvent():
                return execution_entities(message)
            case GraspJudgement():
                return judgement_entities(message)
            case GraspCheck():
                return check_entities(message)
            case Tail():
                self.scene = replace(self.scene, pulled=True)
                return tail_entities(message)
            case SimulatorState():
                shape = message.knots.tobytes(), message.control_points_camera.tobytes()
                truth = self._unless_same("truth", shape, lambda: truth_entities(message))
                return [*self._camera(camera_in_mm(message.camera), None), *truth]
            case Shows():
                return self._as_it_says(message)
            case AgentHealth():
                return [*health_entities(message), *self._dataflow.entities(message)]
            case _:
                return _about_the_session(message)

    def _observations(self, observations: ThreadObservations) -> list[Entity]:
        self._observed.append(observations)
        # the right image is shown as the camera gives it, and was put in line before anything was found in it
        self._right_eye = None if self.scene.raw_images else right_eye_of(observations)
        self._to_shown = from_in_line(self._right_eye, observations.camera)
        if len(observations.matched_px):
            self.scene = replace(self.scene, matched=True)
        grave = [finding_text(judgement) for judgement in findings(observations)]
        words = [said("perception", text, rr.TextLogLevel.WARN) for text in grave]
        codes = tuple(judgement.code for judgement in findings(observations))
        seen = None if observations.occluders is None else observations.occluders.sequence
        return [
            *self._camera(observations.camera, None),
            *mask_entities(coverage(observations.mask_left), coverage(observations.mask_right), self._to_shown),
            *observation_entities(observations, MOST_MATCHED, self._to_shown),
            *candidate_entities(observations, self._to_shown),
            *(occluder_entities(observations, self._to_shown) if self._changed("occluders", seen) else []),
            *score_entities(observations),
            *(verdict_entities(observations) if self._changed("verdict", verdict(observations)) else []),
            *(match_entities(observations) if self.scene.matched else []),
            *(words if self._changed("findings", codes) else []),
            *self._status("perception", observations.status, observations.reason),
        ]

    def _reconstruction(self, reconstruction: ThreadReconstruction) -> list[Entity]:
        self._considered.saw(reconstruction)
        self._look_at(reconstruction)
        depths = reconstruction.control_points_camera[:, 2]
        same_frame = (observed for observed in self._observed if observed.stamp == reconstruction.stamp)
        return [
            *self._camera(reconstruction.camera, float(np.median(depths)) if (depths > 0).any() else None),
            *([*curve_looks(), end_to_end_name()] if self._changed("looks of curves", True) else []),
            *reconstruction_entities(reconstruction, next(same_frame, None), self._to_shown),
            *self._status("reconstruction", reconstruction.status, reconstruction.reason),
            *self._track(reconstruction.track),
        ]

    def _look_at(self, reconstruction: ThreadReconstruction) -> None:
        """Turn the eye to the first thread that is seen."""
        if reconstruction.status is not Status.OK:
            return
        self.scene = replace(self.scene, posterior=len(reconstruction.posterior_s) > 0)
        if self.scene.middle_camera is None:
            middle = np.median(reconstruction.control_points_camera, axis=0)
            unit = unit_text(reconstruction.camera.metres_per_unit)
            self.scene = replace(self.scene, middle_camera=middle, unit=unit)

    def _as_it_says(self, message: Shows) -> list[Entity]:
        """What a message says that it shows, under its agent's name."""
        agent = next(topic.agent for topic in TOPICS if topic.message is type(message))
        shown = message.shown()
        changed = self._changed(f"state of {agent}", shown.state)
        return [
            *self._camera(camera_in_mm(message.camera), None),
            *shown_entities(agent, message.camera, shown, changed),
        ]

    def _robot(self, state: RobotState) -> list[Entity]:
        unit_known = self._shown is None or self._shown[0].metres_per_unit is not None
        first = [joint_names(state.arm, state.kinematics == "")] if self._changed(f"arm {state.arm}", True) else []
        changed = self._changed(f"mode of {state.arm}", state.mode)
        poses = state.T_camera_base.tobytes(), state.T_base_tool.tobytes(), state.jaw_rad, state.kinematics, unit_known
        tool = self._unless_same(
            f"tool of {state.arm}", poses, lambda: robot_tool_entities(state) if unit_known else []
        )
        return [*first, *tool, *robot_numbers(state), *(mode_entities(state) if changed else [])]

    def _camera(self, camera: RectifiedStereo, distance: float | None) -> list[Entity]:
        """The cameras, where they are new or the thread has moved so far that the backdrop must follow."""
        if self._shown is not None and self._shown[:2] == (camera, self._right_eye):
            shown = self._shown[2]
            if distance is None or 0.8 < BACKDROP * distance / shown < 1.25:
                return []
        away = BACKDROP * (
            camera.fx_px * camera.baseline / (0.05 * camera.image_width) if distance is None else distance
        )
        self._shown = (camera, self._right_eye, away)
        return camera_entities(camera, away, self._right_eye)

    def _status(self, stage: str, status: Status, reason: str) -> list[Entity]:
        if not self._changed(f"status of {stage}", (status, reason)):
            return []
        result = lane(stage, status.name.lower())
        return [result, said(stage, reason, rr.TextLogLevel.WARN)] if reason else [result]

    def _track(self, track: ThreadTrack | None) -> list[Entity]:
        """What became of the track, as it changes."""
        if track is None or not self._changed("track", (track.step, track.reason)):
            return []
        step = lane("track", track.step.name.lower())
        return [step, said("reconstruction", f"track: {track.reason}")] if track.reason else [step]

    def _unless_same(self, what: str, made_from: object, make: Callable[[], list[Entity]]) -> list[Entity]:
        """What was made before, where it was made from the same: a thread and an arm at rest are most of the time."""
        if what not in self._made or self._made[what][0] != made_from:
            self._made[what] = made_from, make()
        return self._made[what][1]

    def _changed(self, what: str, value: object) -> bool:
        changed = self._before.get(what) != value
        self._before[what] = value
        return changed


def _echo_ms(stamp: FrameStamp, echo: ChallengeEcho) -> float:
    return 1e-6 * (min(stamp.capture_left_ns, stamp.capture_right_ns) - echo.challenge_ns)


def _about_the_session(message: object) -> list[Entity]:
    match message:
        case LogRecord():
            return log_entities(message)
        case CommandRecord():
            return command_entities(message)
        case AgentConfiguration():
            return configuration_entities(message)
        case HostClocks():
            return clock_entities(message)
        case Heartbeat():
            return [(f"operator/{rr.escape_entity_path_part(message.arm)}/heartbeat", [rr.Scalars(1.0)])]
        case FrameNotice(stamp=stamp):
            # how long a challenge of each arm had been out when the camera echoed it: as old as its bridge takes it
            return [
                (f"camera/{rr.escape_entity_path_part(echo.arm)}/echo_ms", [rr.Scalars(_echo_ms(stamp, echo))])
                for echo in stamp.echoes
            ]
        case ReplayClock():
            return [("replay/rate", [rr.Scalars(message.rate)])]
        case _:
            return []
