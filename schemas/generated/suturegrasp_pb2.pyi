from google.protobuf.internal import containers as _containers
from google.protobuf.internal import enum_type_wrapper as _enum_type_wrapper
from google.protobuf import descriptor as _descriptor
from google.protobuf import message as _message
from collections.abc import Iterable as _Iterable, Mapping as _Mapping
from typing import ClassVar as _ClassVar, Optional as _Optional, Union as _Union

DESCRIPTOR: _descriptor.FileDescriptor

class ImageEncoding(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    IMAGE_ENCODING_UNSPECIFIED: _ClassVar[ImageEncoding]
    IMAGE_ENCODING_RAW: _ClassVar[ImageEncoding]
    IMAGE_ENCODING_PNG: _ClassVar[ImageEncoding]
    IMAGE_ENCODING_JPEG: _ClassVar[ImageEncoding]

class Status(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    STATUS_UNSPECIFIED: _ClassVar[Status]
    STATUS_OK: _ClassVar[Status]
    STATUS_FAILED: _ClassVar[Status]

class Severity(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    SEVERITY_UNSPECIFIED: _ClassVar[Severity]
    SEVERITY_NOTE: _ClassVar[Severity]
    SEVERITY_WARNING: _ClassVar[Severity]
    SEVERITY_FAULT: _ClassVar[Severity]

class Occluder(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    OCCLUDER_UNSPECIFIED: _ClassVar[Occluder]
    OCCLUDER_TOOL: _ClassVar[Occluder]
    OCCLUDER_NEEDLE: _ClassVar[Occluder]
    OCCLUDER_UNKNOWN: _ClassVar[Occluder]

class Over(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    OVER_UNSPECIFIED: _ClassVar[Over]
    OVER_FIRST: _ClassVar[Over]
    OVER_SECOND: _ClassVar[Over]
    OVER_UNDETERMINED: _ClassVar[Over]

class TrackStep(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    TRACK_STEP_UNSPECIFIED: _ClassVar[TrackStep]
    TRACK_STEP_STARTED: _ClassVar[TrackStep]
    TRACK_STEP_CONTINUED: _ClassVar[TrackStep]
    TRACK_STEP_RESTARTED: _ClassVar[TrackStep]
    TRACK_STEP_LOST: _ClassVar[TrackStep]

class Outcome(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    OUTCOME_UNSPECIFIED: _ClassVar[Outcome]
    OUTCOME_ACCEPTED: _ClassVar[Outcome]
    OUTCOME_REFUSED: _ClassVar[Outcome]
    OUTCOME_UNKNOWN: _ClassVar[Outcome]

class LogLevel(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    LOG_LEVEL_UNSPECIFIED: _ClassVar[LogLevel]
    LOG_LEVEL_DEBUG: _ClassVar[LogLevel]
    LOG_LEVEL_INFO: _ClassVar[LogLevel]
    LOG_LEVEL_WARNING: _ClassVar[LogLevel]
    LOG_LEVEL_ERROR: _ClassVar[LogLevel]

class Policy(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    POLICY_UNSPECIFIED: _ClassVar[Policy]
    POLICY_DIRECT: _ClassVar[Policy]
    POLICY_CAPTURE_SLIDE_GRASP: _ClassVar[Policy]

class StateWord(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    STATE_WORD_UNSPECIFIED: _ClassVar[StateWord]
    STATE_WORD_ENABLE: _ClassVar[StateWord]
    STATE_WORD_DISABLE: _ClassVar[StateWord]
    STATE_WORD_PAUSE: _ClassVar[StateWord]
    STATE_WORD_RESUME: _ClassVar[StateWord]
    STATE_WORD_HOME: _ClassVar[StateWord]

class Phase(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    PHASE_UNSPECIFIED: _ClassVar[Phase]
    PHASE_APPROACH: _ClassVar[Phase]
    PHASE_CAPTURE: _ClassVar[Phase]
    PHASE_SLIDE: _ClassVar[Phase]
    PHASE_GRASP: _ClassVar[Phase]
    PHASE_RETREAT: _ClassVar[Phase]

class Checked(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    CHECKED_UNSPECIFIED: _ClassVar[Checked]
    CHECKED_HELD: _ClassVar[Checked]
    CHECKED_MISSED: _ClassVar[Checked]
    CHECKED_UNKNOWN: _ClassVar[Checked]

class RobotMode(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    ROBOT_MODE_UNSPECIFIED: _ClassVar[RobotMode]
    ROBOT_MODE_DISABLED: _ClassVar[RobotMode]
    ROBOT_MODE_IDLE: _ClassVar[RobotMode]
    ROBOT_MODE_MOVING: _ClassVar[RobotMode]
    ROBOT_MODE_HOLDING: _ClassVar[RobotMode]
    ROBOT_MODE_FAULT: _ClassVar[RobotMode]

class ToolStatus(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    TOOL_STATUS_UNSPECIFIED: _ClassVar[ToolStatus]
    TOOL_STATUS_CONVERGING: _ClassVar[ToolStatus]
    TOOL_STATUS_CONVERGED: _ClassVar[ToolStatus]
    TOOL_STATUS_LOST: _ClassVar[ToolStatus]

class ExecutionKind(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    EXECUTION_KIND_UNSPECIFIED: _ClassVar[ExecutionKind]
    EXECUTION_KIND_ACCEPTED: _ClassVar[ExecutionKind]
    EXECUTION_KIND_PHASE_REACHED: _ClassVar[ExecutionKind]
    EXECUTION_KIND_FINISHED: _ClassVar[ExecutionKind]
    EXECUTION_KIND_REFUSED: _ClassVar[ExecutionKind]
    EXECUTION_KIND_HELD: _ClassVar[ExecutionKind]
    EXECUTION_KIND_SEGMENT_ENDED: _ClassVar[ExecutionKind]

class Verdict(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    VERDICT_UNSPECIFIED: _ClassVar[Verdict]
    VERDICT_HELD: _ClassVar[Verdict]
    VERDICT_MISSED: _ClassVar[Verdict]
    VERDICT_LOST: _ClassVar[Verdict]
    VERDICT_FORCE_EXCEEDED: _ClassVar[Verdict]
IMAGE_ENCODING_UNSPECIFIED: ImageEncoding
IMAGE_ENCODING_RAW: ImageEncoding
IMAGE_ENCODING_PNG: ImageEncoding
IMAGE_ENCODING_JPEG: ImageEncoding
STATUS_UNSPECIFIED: Status
STATUS_OK: Status
STATUS_FAILED: Status
SEVERITY_UNSPECIFIED: Severity
SEVERITY_NOTE: Severity
SEVERITY_WARNING: Severity
SEVERITY_FAULT: Severity
OCCLUDER_UNSPECIFIED: Occluder
OCCLUDER_TOOL: Occluder
OCCLUDER_NEEDLE: Occluder
OCCLUDER_UNKNOWN: Occluder
OVER_UNSPECIFIED: Over
OVER_FIRST: Over
OVER_SECOND: Over
OVER_UNDETERMINED: Over
TRACK_STEP_UNSPECIFIED: TrackStep
TRACK_STEP_STARTED: TrackStep
TRACK_STEP_CONTINUED: TrackStep
TRACK_STEP_RESTARTED: TrackStep
TRACK_STEP_LOST: TrackStep
OUTCOME_UNSPECIFIED: Outcome
OUTCOME_ACCEPTED: Outcome
OUTCOME_REFUSED: Outcome
OUTCOME_UNKNOWN: Outcome
LOG_LEVEL_UNSPECIFIED: LogLevel
LOG_LEVEL_DEBUG: LogLevel
LOG_LEVEL_INFO: LogLevel
LOG_LEVEL_WARNING: LogLevel
LOG_LEVEL_ERROR: LogLevel
POLICY_UNSPECIFIED: Policy
POLICY_DIRECT: Policy
POLICY_CAPTURE_SLIDE_GRASP: Policy
STATE_WORD_UNSPECIFIED: StateWord
STATE_WORD_ENABLE: StateWord
STATE_WORD_DISABLE: StateWord
STATE_WORD_PAUSE: StateWord
STATE_WORD_RESUME: StateWord
STATE_WORD_HOME: StateWord
PHASE_UNSPECIFIED: Phase
PHASE_APPROACH: Phase
PHASE_CAPTURE: Phase
PHASE_SLIDE: Phase
PHASE_GRASP: Phase
PHASE_RETREAT: Phase
CHECKED_UNSPECIFIED: Checked
CHECKED_HELD: Checked
CHECKED_MISSED: Checked
CHECKED_UNKNOWN: Checked
ROBOT_MODE_UNSPECIFIED: RobotMode
ROBOT_MODE_DISABLED: RobotMode
ROBOT_MODE_IDLE: RobotMode
ROBOT_MODE_MOVING: RobotMode
ROBOT_MODE_HOLDING: RobotMode
ROBOT_MODE_FAULT: RobotMode
TOOL_STATUS_UNSPECIFIED: ToolStatus
TOOL_STATUS_CONVERGING: ToolStatus
TOOL_STATUS_CONVERGED: ToolStatus
TOOL_STATUS_LOST: ToolStatus
EXECUTION_KIND_UNSPECIFIED: ExecutionKind
EXECUTION_KIND_ACCEPTED: ExecutionKind
EXECUTION_KIND_PHASE_REACHED: ExecutionKind
EXECUTION_KIND_FINISHED: ExecutionKind
EXECUTION_KIND_REFUSED: ExecutionKind
EXECUTION_KIND_HELD: ExecutionKind
EXECUTION_KIND_SEGMENT_ENDED: ExecutionKind
VERDICT_UNSPECIFIED: Verdict
VERDICT_HELD: Verdict
VERDICT_MISSED: Verdict
VERDICT_LOST: Verdict
VERDICT_FORCE_EXCEEDED: Verdict

class Array(_message.Message):
    __slots__ = ("dtype", "shape", "data")
    DTYPE_FIELD_NUMBER: _ClassVar[int]
    SHAPE_FIELD_NUMBER: _ClassVar[int]
    DATA_FIELD_NUMBER: _ClassVar[int]
    dtype: str
    shape: _containers.RepeatedScalarFieldContainer[int]
    data: bytes
    def __init__(self, dtype: _Optional[str] = ..., shape: _Optional[_Iterable[int]] = ..., data: _Optional[bytes] = ...) -> None: ...

class Image(_message.Message):
    __slots__ = ("encoding", "width", "height", "channels", "data")
    ENCODING_FIELD_NUMBER: _ClassVar[int]
    WIDTH_FIELD_NUMBER: _ClassVar[int]
    HEIGHT_FIELD_NUMBER: _ClassVar[int]
    CHANNELS_FIELD_NUMBER: _ClassVar[int]
    DATA_FIELD_NUMBER: _ClassVar[int]
    encoding: ImageEncoding
    width: int
    height: int
    channels: int
    data: bytes
    def __init__(self, encoding: _Optional[_Union[ImageEncoding, str]] = ..., width: _Optional[int] = ..., height: _Optional[int] = ..., channels: _Optional[int] = ..., data: _Optional[bytes] = ...) -> None: ...

class FrameStamp(_message.Message):
    __slots__ = ("sequence", "capture_left_ns", "capture_right_ns", "calibration_id", "echoes")
    SEQUENCE_FIELD_NUMBER: _ClassVar[int]
    CAPTURE_LEFT_NS_FIELD_NUMBER: _ClassVar[int]
    CAPTURE_RIGHT_NS_FIELD_NUMBER: _ClassVar[int]
    CALIBRATION_ID_FIELD_NUMBER: _ClassVar[int]
    ECHOES_FIELD_NUMBER: _ClassVar[int]
    sequence: int
    capture_left_ns: int
    capture_right_ns: int
    calibration_id: str
    echoes: _containers.RepeatedCompositeFieldContainer[ChallengeEcho]
    def __init__(self, sequence: _Optional[int] = ..., capture_left_ns: _Optional[int] = ..., capture_right_ns: _Optional[int] = ..., calibration_id: _Optional[str] = ..., echoes: _Optional[_Iterable[_Union[ChallengeEcho, _Mapping]]] = ...) -> None: ...

class ChallengeEcho(_message.Message):
    __slots__ = ("arm", "challenge_ns")
    ARM_FIELD_NUMBER: _ClassVar[int]
    CHALLENGE_NS_FIELD_NUMBER: _ClassVar[int]
    arm: str
    challenge_ns: int
    def __init__(self, arm: _Optional[str] = ..., challenge_ns: _Optional[int] = ...) -> None: ...

class FrameNotice(_message.Message):
    __slots__ = ("stamp", "consumed")
    STAMP_FIELD_NUMBER: _ClassVar[int]
    CONSUMED_FIELD_NUMBER: _ClassVar[int]
    stamp: FrameStamp
    consumed: _containers.RepeatedCompositeFieldContainer[Consumed]
    def __init__(self, stamp: _Optional[_Union[FrameStamp, _Mapping]] = ..., consumed: _Optional[_Iterable[_Union[Consumed, _Mapping]]] = ...) -> None: ...

class StereoFrame(_message.Message):
    __slots__ = ("stamp", "left", "right", "consumed")
    STAMP_FIELD_NUMBER: _ClassVar[int]
    LEFT_FIELD_NUMBER: _ClassVar[int]
    RIGHT_FIELD_NUMBER: _ClassVar[int]
    CONSUMED_FIELD_NUMBER: _ClassVar[int]
    stamp: FrameStamp
    left: Image
    right: Image
    consumed: _containers.RepeatedCompositeFieldContainer[Consumed]
    def __init__(self, stamp: _Optional[_Union[FrameStamp, _Mapping]] = ..., left: _Optional[_Union[Image, _Mapping]] = ..., right: _Optional[_Union[Image, _Mapping]] = ..., consumed: _Optional[_Iterable[_Union[Consumed, _Mapping]]] = ...) -> None: ...

class StereoCalibration(_message.Message):
    __slots__ = ("image_width", "image_height", "K_left", "K_right", "distortion_left", "distortion_right", "T_right_left", "metres_per_unit", "consumed", "covariance")
    IMAGE_WIDTH_FIELD_NUMBER: _ClassVar[int]
    IMAGE_HEIGHT_FIELD_NUMBER: _ClassVar[int]
    K_LEFT_FIELD_NUMBER: _ClassVar[int]
    K_RIGHT_FIELD_NUMBER: _ClassVar[int]
    DISTORTION_LEFT_FIELD_NUMBER: _ClassVar[int]
    DISTORTION_RIGHT_FIELD_NUMBER: _ClassVar[int]
    T_RIGHT_LEFT_FIELD_NUMBER: _ClassVar[int]
    METRES_PER_UNIT_FIELD_NUMBER: _ClassVar[int]
    CONSUMED_FIELD_NUMBER: _ClassVar[int]
    COVARIANCE_FIELD_NUMBER: _ClassVar[int]
    image_width: int
    image_height: int
    K_left: Array
    K_right: Array
    distortion_left: Array
    distortion_right: Array
    T_right_left: Array
    metres_per_unit: float
    consumed: _containers.RepeatedCompositeFieldContainer[Consumed]
    covariance: Array
    def __init__(self, image_width: _Optional[int] = ..., image_height: _Optional[int] = ..., K_left: _Optional[_Union[Array, _Mapping]] = ..., K_right: _Optional[_Union[Array, _Mapping]] = ..., distortion_left: _Optional[_Union[Array, _Mapping]] = ..., distortion_right: _Optional[_Union[Array, _Mapping]] = ..., T_right_left: _Optional[_Union[Array, _Mapping]] = ..., metres_per_unit: _Optional[float] = ..., consumed: _Optional[_Iterable[_Union[Consumed, _Mapping]]] = ..., covariance: _Optional[_Union[Array, _Mapping]] = ...) -> None: ...

class RectifiedStereo(_message.Message):
    __slots__ = ("image_width", "image_height", "fx_px", "fy_px", "cx_px", "cy_px", "baseline", "metres_per_unit")
    IMAGE_WIDTH_FIELD_NUMBER: _ClassVar[int]
    IMAGE_HEIGHT_FIELD_NUMBER: _ClassVar[int]
    FX_PX_FIELD_NUMBER: _ClassVar[int]
    FY_PX_FIELD_NUMBER: _ClassVar[int]
    CX_PX_FIELD_NUMBER: _ClassVar[int]
    CY_PX_FIELD_NUMBER: _ClassVar[int]
    BASELINE_FIELD_NUMBER: _ClassVar[int]
    METRES_PER_UNIT_FIELD_NUMBER: _ClassVar[int]
    image_width: int
    image_height: int
    fx_px: float
    fy_px: float
    cx_px: float
    cy_px: float
    baseline: float
    metres_per_unit: float
    def __init__(self, image_width: _Optional[int] = ..., image_height: _Optional[int] = ..., fx_px: _Optional[float] = ..., fy_px: _Optional[float] = ..., cx_px: _Optional[float] = ..., cy_px: _Optional[float] = ..., baseline: _Optional[float] = ..., metres_per_unit: _Optional[float] = ...) -> None: ...

class Judgement(_message.Message):
    __slots__ = ("code", "severity", "finding", "remedy")
    CODE_FIELD_NUMBER: _ClassVar[int]
    SEVERITY_FIELD_NUMBER: _ClassVar[int]
    FINDING_FIELD_NUMBER: _ClassVar[int]
    REMEDY_FIELD_NUMBER: _ClassVar[int]
    code: str
    severity: Severity
    finding: str
    remedy: str
    def __init__(self, code: _Optional[str] = ..., severity: _Optional[_Union[Severity, str]] = ..., finding: _Optional[str] = ..., remedy: _Optional[str] = ...) -> None: ...

class Centrelines(_message.Message):
    __slots__ = ("point_px", "piece", "width_px", "deviation_px")
    POINT_PX_FIELD_NUMBER: _ClassVar[int]
    PIECE_FIELD_NUMBER: _ClassVar[int]
    WIDTH_PX_FIELD_NUMBER: _ClassVar[int]
    DEVIATION_PX_FIELD_NUMBER: _ClassVar[int]
    point_px: Array
    piece: Array
    width_px: Array
    deviation_px: Array
    def __init__(self, point_px: _Optional[_Union[Array, _Mapping]] = ..., piece: _Optional[_Union[Array, _Mapping]] = ..., width_px: _Optional[_Union[Array, _Mapping]] = ..., deviation_px: _Optional[_Union[Array, _Mapping]] = ...) -> None: ...

class ThreadCandidate(_message.Message):
    __slots__ = ("score", "left_px", "right_px", "width_px", "colour_bgr")
    SCORE_FIELD_NUMBER: _ClassVar[int]
    LEFT_PX_FIELD_NUMBER: _ClassVar[int]
    RIGHT_PX_FIELD_NUMBER: _ClassVar[int]
    WIDTH_PX_FIELD_NUMBER: _ClassVar[int]
    COLOUR_BGR_FIELD_NUMBER: _ClassVar[int]
    score: float
    left_px: Array
    right_px: Array
    width_px: float
    colour_bgr: Array
    def __init__(self, score: _Optional[float] = ..., left_px: _Optional[_Union[Array, _Mapping]] = ..., right_px: _Optional[_Union[Array, _Mapping]] = ..., width_px: _Optional[float] = ..., colour_bgr: _Optional[_Union[Array, _Mapping]] = ...) -> None: ...

class Occluders(_message.Message):
    __slots__ = ("left", "right", "sequence")
    LEFT_FIELD_NUMBER: _ClassVar[int]
    RIGHT_FIELD_NUMBER: _ClassVar[int]
    SEQUENCE_FIELD_NUMBER: _ClassVar[int]
    left: Image
    right: Image
    sequence: int
    def __init__(self, left: _Optional[_Union[Image, _Mapping]] = ..., right: _Optional[_Union[Image, _Mapping]] = ..., sequence: _Optional[int] = ...) -> None: ...

class Trail(_message.Message):
    __slots__ = ("loose_start", "loose_end", "length_px", "colour_bgr", "told_start", "told_end")
    LOOSE_START_FIELD_NUMBER: _ClassVar[int]
    LOOSE_END_FIELD_NUMBER: _ClassVar[int]
    LENGTH_PX_FIELD_NUMBER: _ClassVar[int]
    COLOUR_BGR_FIELD_NUMBER: _ClassVar[int]
    TOLD_START_FIELD_NUMBER: _ClassVar[int]
    TOLD_END_FIELD_NUMBER: _ClassVar[int]
    loose_start: Array
    loose_end: Array
    length_px: Array
    colour_bgr: Array
    told_start: Array
    told_end: Array
    def __init__(self, loose_start: _Optional[_Union[Array, _Mapping]] = ..., loose_end: _Optional[_Union[Array, _Mapping]] = ..., length_px: _Optional[_Union[Array, _Mapping]] = ..., colour_bgr: _Optional[_Union[Array, _Mapping]] = ..., told_start: _Optional[_Union[Array, _Mapping]] = ..., told_end: _Optional[_Union[Array, _Mapping]] = ...) -> None: ...

class RightEye(_message.Message):
    __slots__ = ("rows_px", "turned_deg", "magnified")
    ROWS_PX_FIELD_NUMBER: _ClassVar[int]
    TURNED_DEG_FIELD_NUMBER: _ClassVar[int]
    MAGNIFIED_FIELD_NUMBER: _ClassVar[int]
    rows_px: float
    turned_deg: float
    magnified: float
    def __init__(self, rows_px: _Optional[float] = ..., turned_deg: _Optional[float] = ..., magnified: _Optional[float] = ...) -> None: ...

class ThreadObservations(_message.Message):
    __slots__ = ("stamp", "camera", "status", "reason", "segmenter", "points_camera", "half_size_px", "matched_px", "match_cost", "inlier", "mask_left", "mask_right", "judgements", "gaps", "centrelines_left", "centrelines_right", "looked_sequence", "is_bright", "prompt_px", "rows_moved_up", "picture_left", "picture_right", "picture_left_since", "picture_right_since", "candidates", "occluders", "score_map", "surface_sequence", "trail_left", "trail_right", "segmented_sequence", "frames_since_look", "judged_sequence", "glanced_sequence", "glances", "right_eye", "disparities_px", "calibration_covariance", "consumed")
    STAMP_FIELD_NUMBER: _ClassVar[int]
    CAMERA_FIELD_NUMBER: _ClassVar[int]
    STATUS_FIELD_NUMBER: _ClassVar[int]
    REASON_FIELD_NUMBER: _ClassVar[int]
    SEGMENTER_FIELD_NUMBER: _ClassVar[int]
    POINTS_CAMERA_FIELD_NUMBER: _ClassVar[int]
    HALF_SIZE_PX_FIELD_NUMBER: _ClassVar[int]
    MATCHED_PX_FIELD_NUMBER: _ClassVar[int]
    MATCH_COST_FIELD_NUMBER: _ClassVar[int]
    INLIER_FIELD_NUMBER: _ClassVar[int]
    MASK_LEFT_FIELD_NUMBER: _ClassVar[int]
    MASK_RIGHT_FIELD_NUMBER: _ClassVar[int]
    JUDGEMENTS_FIELD_NUMBER: _ClassVar[int]
    GAPS_FIELD_NUMBER: _ClassVar[int]
    CENTRELINES_LEFT_FIELD_NUMBER: _ClassVar[int]
    CENTRELINES_RIGHT_FIELD_NUMBER: _ClassVar[int]
    LOOKED_SEQUENCE_FIELD_NUMBER: _ClassVar[int]
    IS_BRIGHT_FIELD_NUMBER: _ClassVar[int]
    PROMPT_PX_FIELD_NUMBER: _ClassVar[int]
    ROWS_MOVED_UP_FIELD_NUMBER: _ClassVar[int]
    PICTURE_LEFT_FIELD_NUMBER: _ClassVar[int]
    PICTURE_RIGHT_FIELD_NUMBER: _ClassVar[int]
    PICTURE_LEFT_SINCE_FIELD_NUMBER: _ClassVar[int]
    PICTURE_RIGHT_SINCE_FIELD_NUMBER: _ClassVar[int]
    CANDIDATES_FIELD_NUMBER: _ClassVar[int]
    OCCLUDERS_FIELD_NUMBER: _ClassVar[int]
    SCORE_MAP_FIELD_NUMBER: _ClassVar[int]
    SURFACE_SEQUENCE_FIELD_NUMBER: _ClassVar[int]
    TRAIL_LEFT_FIELD_NUMBER: _ClassVar[int]
    TRAIL_RIGHT_FIELD_NUMBER: _ClassVar[int]
    SEGMENTED_SEQUENCE_FIELD_NUMBER: _ClassVar[int]
    FRAMES_SINCE_LOOK_FIELD_NUMBER: _ClassVar[int]
    JUDGED_SEQUENCE_FIELD_NUMBER: _ClassVar[int]
    GLANCED_SEQUENCE_FIELD_NUMBER: _ClassVar[int]
    GLANCES_FIELD_NUMBER: _ClassVar[int]
    RIGHT_EYE_FIELD_NUMBER: _ClassVar[int]
    DISPARITIES_PX_FIELD_NUMBER: _ClassVar[int]
    CALIBRATION_COVARIANCE_FIELD_NUMBER: _ClassVar[int]
    CONSUMED_FIELD_NUMBER: _ClassVar[int]
    stamp: FrameStamp
    camera: RectifiedStereo
    status: Status
    reason: str
    segmenter: str
    points_camera: Array
    half_size_px: Array
    matched_px: Array
    match_cost: Array
    inlier: Array
    mask_left: Image
    mask_right: Image
    judgements: _containers.RepeatedCompositeFieldContainer[Judgement]
    gaps: Array
    centrelines_left: Centrelines
    centrelines_right: Centrelines
    looked_sequence: int
    is_bright: bool
    prompt_px: Array
    rows_moved_up: int
    picture_left: int
    picture_right: int
    picture_left_since: int
    picture_right_since: int
    candidates: _containers.RepeatedCompositeFieldContainer[ThreadCandidate]
    occluders: Occluders
    score_map: Image
    surface_sequence: int
    trail_left: Trail
    trail_right: Trail
    segmented_sequence: int
    frames_since_look: int
    judged_sequence: int
    glanced_sequence: int
    glances: int
    right_eye: RightEye
    disparities_px: Array
    calibration_covariance: Array
    consumed: _containers.RepeatedCompositeFieldContainer[Consumed]
    def __init__(self, stamp: _Optional[_Union[FrameStamp, _Mapping]] = ..., camera: _Optional[_Union[RectifiedStereo, _Mapping]] = ..., status: _Optional[_Union[Status, str]] = ..., reason: _Optional[str] = ..., segmenter: _Optional[str] = ..., points_camera: _Optional[_Union[Array, _Mapping]] = ..., half_size_px: _Optional[_Union[Array, _Mapping]] = ..., matched_px: _Optional[_Union[Array, _Mapping]] = ..., match_cost: _Optional[_Union[Array, _Mapping]] = ..., inlier: _Optional[_Union[Array, _Mapping]] = ..., mask_left: _Optional[_Union[Image, _Mapping]] = ..., mask_right: _Optional[_Union[Image, _Mapping]] = ..., judgements: _Optional[_Iterable[_Union[Judgement, _Mapping]]] = ..., gaps: _Optional[_Union[Array, _Mapping]] = ..., centrelines_left: _Optional[_Union[Centrelines, _Mapping]] = ..., centrelines_right: _Optional[_Union[Centrelines, _Mapping]] = ..., looked_sequence: _Optional[int] = ..., is_bright: _Optional[bool] = ..., prompt_px: _Optional[_Union[Array, _Mapping]] = ..., rows_moved_up: _Optional[int] = ..., picture_left: _Optional[int] = ..., picture_right: _Optional[int] = ..., picture_left_since: _Optional[int] = ..., picture_right_since: _Optional[int] = ..., candidates: _Optional[_Iterable[_Union[ThreadCandidate, _Mapping]]] = ..., occluders: _Optional[_Union[Occluders, _Mapping]] = ..., score_map: _Optional[_Union[Image, _Mapping]] = ..., surface_sequence: _Optional[int] = ..., trail_left: _Optional[_Union[Trail, _Mapping]] = ..., trail_right: _Optional[_Union[Trail, _Mapping]] = ..., segmented_sequence: _Optional[int] = ..., frames_since_look: _Optional[int] = ..., judged_sequence: _Optional[int] = ..., glanced_sequence: _Optional[int] = ..., glances: _Optional[int] = ..., right_eye: _Optional[_Union[RightEye, _Mapping]] = ..., disparities_px: _Optional[_Union[Array, _Mapping]] = ..., calibration_covariance: _Optional[_Union[Array, _Mapping]] = ..., consumed: _Optional[_Iterable[_Union[Consumed, _Mapping]]] = ...) -> None: ...

class TissueSurface(_message.Message):
    __slots__ = ("stamp", "camera", "u_px", "v_px", "depth", "valid", "deviation", "consumed")
    STAMP_FIELD_NUMBER: _ClassVar[int]
    CAMERA_FIELD_NUMBER: _ClassVar[int]
    U_PX_FIELD_NUMBER: _ClassVar[int]
    V_PX_FIELD_NUMBER: _ClassVar[int]
    DEPTH_FIELD_NUMBER: _ClassVar[int]
    VALID_FIELD_NUMBER: _ClassVar[int]
    DEVIATION_FIELD_NUMBER: _ClassVar[int]
    CONSUMED_FIELD_NUMBER: _ClassVar[int]
    stamp: FrameStamp
    camera: RectifiedStereo
    u_px: Array
    v_px: Array
    depth: Array
    valid: Array
    deviation: Array
    consumed: _containers.RepeatedCompositeFieldContainer[Consumed]
    def __init__(self, stamp: _Optional[_Union[FrameStamp, _Mapping]] = ..., camera: _Optional[_Union[RectifiedStereo, _Mapping]] = ..., u_px: _Optional[_Union[Array, _Mapping]] = ..., v_px: _Optional[_Union[Array, _Mapping]] = ..., depth: _Optional[_Union[Array, _Mapping]] = ..., valid: _Optional[_Union[Array, _Mapping]] = ..., deviation: _Optional[_Union[Array, _Mapping]] = ..., consumed: _Optional[_Iterable[_Union[Consumed, _Mapping]]] = ...) -> None: ...

class ReliabilityRegions(_message.Message):
    __slots__ = ("s", "centre_camera", "bound_px", "bound_depth", "slack")
    S_FIELD_NUMBER: _ClassVar[int]
    CENTRE_CAMERA_FIELD_NUMBER: _ClassVar[int]
    BOUND_PX_FIELD_NUMBER: _ClassVar[int]
    BOUND_DEPTH_FIELD_NUMBER: _ClassVar[int]
    SLACK_FIELD_NUMBER: _ClassVar[int]
    s: Array
    centre_camera: Array
    bound_px: Array
    bound_depth: Array
    slack: Array
    def __init__(self, s: _Optional[_Union[Array, _Mapping]] = ..., centre_camera: _Optional[_Union[Array, _Mapping]] = ..., bound_px: _Optional[_Union[Array, _Mapping]] = ..., bound_depth: _Optional[_Union[Array, _Mapping]] = ..., slack: _Optional[_Union[Array, _Mapping]] = ...) -> None: ...

class ThreadReconstruction(_message.Message):
    __slots__ = ("stamp", "camera", "status", "reason", "method", "degree", "knots", "control_points_camera", "regions", "confidence_s", "confidence", "posterior_s", "posterior_covariance", "unseen", "consumed", "track", "crossings", "other_threads_px", "hidden", "ends_hidden", "other_threads", "left_over_share", "left_over_px", "calibration_covariance", "course")
    STAMP_FIELD_NUMBER: _ClassVar[int]
    CAMERA_FIELD_NUMBER: _ClassVar[int]
    STATUS_FIELD_NUMBER: _ClassVar[int]
    REASON_FIELD_NUMBER: _ClassVar[int]
    METHOD_FIELD_NUMBER: _ClassVar[int]
    DEGREE_FIELD_NUMBER: _ClassVar[int]
    KNOTS_FIELD_NUMBER: _ClassVar[int]
    CONTROL_POINTS_CAMERA_FIELD_NUMBER: _ClassVar[int]
    REGIONS_FIELD_NUMBER: _ClassVar[int]
    CONFIDENCE_S_FIELD_NUMBER: _ClassVar[int]
    CONFIDENCE_FIELD_NUMBER: _ClassVar[int]
    POSTERIOR_S_FIELD_NUMBER: _ClassVar[int]
    POSTERIOR_COVARIANCE_FIELD_NUMBER: _ClassVar[int]
    UNSEEN_FIELD_NUMBER: _ClassVar[int]
    CONSUMED_FIELD_NUMBER: _ClassVar[int]
    TRACK_FIELD_NUMBER: _ClassVar[int]
    CROSSINGS_FIELD_NUMBER: _ClassVar[int]
    OTHER_THREADS_PX_FIELD_NUMBER: _ClassVar[int]
    HIDDEN_FIELD_NUMBER: _ClassVar[int]
    ENDS_HIDDEN_FIELD_NUMBER: _ClassVar[int]
    OTHER_THREADS_FIELD_NUMBER: _ClassVar[int]
    LEFT_OVER_SHARE_FIELD_NUMBER: _ClassVar[int]
    LEFT_OVER_PX_FIELD_NUMBER: _ClassVar[int]
    CALIBRATION_COVARIANCE_FIELD_NUMBER: _ClassVar[int]
    COURSE_FIELD_NUMBER: _ClassVar[int]
    stamp: FrameStamp
    camera: RectifiedStereo
    status: Status
    reason: str
    method: str
    degree: int
    knots: Array
    control_points_camera: Array
    regions: ReliabilityRegions
    confidence_s: Array
    confidence: Array
    posterior_s: Array
    posterior_covariance: Array
    unseen: Array
    consumed: _containers.RepeatedCompositeFieldContainer[Consumed]
    track: ThreadTrack
    crossings: _containers.RepeatedCompositeFieldContainer[Crossing]
    other_threads_px: Array
    hidden: Array
    ends_hidden: Array
    other_threads: _containers.RepeatedCompositeFieldContainer[ThreadCandidate]
    left_over_share: float
    left_over_px: Array
    calibration_covariance: Array
    course: ThreadCourse
    def __init__(self, stamp: _Optional[_Union[FrameStamp, _Mapping]] = ..., camera: _Optional[_Union[RectifiedStereo, _Mapping]] = ..., status: _Optional[_Union[Status, str]] = ..., reason: _Optional[str] = ..., method: _Optional[str] = ..., degree: _Optional[int] = ..., knots: _Optional[_Union[Array, _Mapping]] = ..., control_points_camera: _Optional[_Union[Array, _Mapping]] = ..., regions: _Optional[_Union[ReliabilityRegions, _Mapping]] = ..., confidence_s: _Optional[_Union[Array, _Mapping]] = ..., confidence: _Optional[_Union[Array, _Mapping]] = ..., posterior_s: _Optional[_Union[Array, _Mapping]] = ..., posterior_covariance: _Optional[_Union[Array, _Mapping]] = ..., unseen: _Optional[_Union[Array, _Mapping]] = ..., consumed: _Optional[_Iterable[_Union[Consumed, _Mapping]]] = ..., track: _Optional[_Union[ThreadTrack, _Mapping]] = ..., crossings: _Optional[_Iterable[_Union[Crossing, _Mapping]]] = ..., other_threads_px: _Optional[_Union[Array, _Mapping]] = ..., hidden: _Optional[_Union[Array, _Mapping]] = ..., ends_hidden: _Optional[_Union[Array, _Mapping]] = ..., other_threads: _Optional[_Iterable[_Union[ThreadCandidate, _Mapping]]] = ..., left_over_share: _Optional[float] = ..., left_over_px: _Optional[_Union[Array, _Mapping]] = ..., calibration_covariance: _Optional[_Union[Array, _Mapping]] = ..., course: _Optional[_Union[ThreadCourse, _Mapping]] = ...) -> None: ...

class ThreadCourse(_message.Message):
    __slots__ = ("joins", "probability", "other")
    JOINS_FIELD_NUMBER: _ClassVar[int]
    PROBABILITY_FIELD_NUMBER: _ClassVar[int]
    OTHER_FIELD_NUMBER: _ClassVar[int]
    joins: Array
    probability: Array
    other: Array
    def __init__(self, joins: _Optional[_Union[Array, _Mapping]] = ..., probability: _Optional[_Union[Array, _Mapping]] = ..., other: _Optional[_Union[Array, _Mapping]] = ...) -> None: ...

class Crossing(_message.Message):
    __slots__ = ("s_first", "s_second", "point_px", "over", "depth_apart")
    S_FIRST_FIELD_NUMBER: _ClassVar[int]
    S_SECOND_FIELD_NUMBER: _ClassVar[int]
    POINT_PX_FIELD_NUMBER: _ClassVar[int]
    OVER_FIELD_NUMBER: _ClassVar[int]
    DEPTH_APART_FIELD_NUMBER: _ClassVar[int]
    s_first: float
    s_second: float
    point_px: Array
    over: Over
    depth_apart: float
    def __init__(self, s_first: _Optional[float] = ..., s_second: _Optional[float] = ..., point_px: _Optional[_Union[Array, _Mapping]] = ..., over: _Optional[_Union[Over, str]] = ..., depth_apart: _Optional[float] = ...) -> None: ...

class ThreadTrack(_message.Message):
    __slots__ = ("step", "reason", "frames", "innovation", "found_share", "stamp", "knots", "control_points_camera", "covariance", "smoothing", "span_weight", "row_offset_px", "length", "material_s", "row_slopes_px", "velocity_camera")
    STEP_FIELD_NUMBER: _ClassVar[int]
    REASON_FIELD_NUMBER: _ClassVar[int]
    FRAMES_FIELD_NUMBER: _ClassVar[int]
    INNOVATION_FIELD_NUMBER: _ClassVar[int]
    FOUND_SHARE_FIELD_NUMBER: _ClassVar[int]
    STAMP_FIELD_NUMBER: _ClassVar[int]
    KNOTS_FIELD_NUMBER: _ClassVar[int]
    CONTROL_POINTS_CAMERA_FIELD_NUMBER: _ClassVar[int]
    COVARIANCE_FIELD_NUMBER: _ClassVar[int]
    SMOOTHING_FIELD_NUMBER: _ClassVar[int]
    SPAN_WEIGHT_FIELD_NUMBER: _ClassVar[int]
    ROW_OFFSET_PX_FIELD_NUMBER: _ClassVar[int]
    LENGTH_FIELD_NUMBER: _ClassVar[int]
    MATERIAL_S_FIELD_NUMBER: _ClassVar[int]
    ROW_SLOPES_PX_FIELD_NUMBER: _ClassVar[int]
    VELOCITY_CAMERA_FIELD_NUMBER: _ClassVar[int]
    step: TrackStep
    reason: str
    frames: int
    innovation: float
    found_share: float
    stamp: FrameStamp
    knots: Array
    control_points_camera: Array
    covariance: Array
    smoothing: float
    span_weight: Array
    row_offset_px: float
    length: float
    material_s: Array
    row_slopes_px: Array
    velocity_camera: Array
    def __init__(self, step: _Optional[_Union[TrackStep, str]] = ..., reason: _Optional[str] = ..., frames: _Optional[int] = ..., innovation: _Optional[float] = ..., found_share: _Optional[float] = ..., stamp: _Optional[_Union[FrameStamp, _Mapping]] = ..., knots: _Optional[_Union[Array, _Mapping]] = ..., control_points_camera: _Optional[_Union[Array, _Mapping]] = ..., covariance: _Optional[_Union[Array, _Mapping]] = ..., smoothing: _Optional[float] = ..., span_weight: _Optional[_Union[Array, _Mapping]] = ..., row_offset_px: _Optional[float] = ..., length: _Optional[float] = ..., material_s: _Optional[_Union[Array, _Mapping]] = ..., row_slopes_px: _Optional[_Union[Array, _Mapping]] = ..., velocity_camera: _Optional[_Union[Array, _Mapping]] = ...) -> None: ...

class Consumed(_message.Message):
    __slots__ = ("key", "epoch", "sequence")
    KEY_FIELD_NUMBER: _ClassVar[int]
    EPOCH_FIELD_NUMBER: _ClassVar[int]
    SEQUENCE_FIELD_NUMBER: _ClassVar[int]
    key: str
    epoch: int
    sequence: int
    def __init__(self, key: _Optional[str] = ..., epoch: _Optional[int] = ..., sequence: _Optional[int] = ...) -> None: ...

class CommandHeader(_message.Message):
    __slots__ = ("id", "deadline_ns", "sender")
    ID_FIELD_NUMBER: _ClassVar[int]
    DEADLINE_NS_FIELD_NUMBER: _ClassVar[int]
    SENDER_FIELD_NUMBER: _ClassVar[int]
    id: str
    deadline_ns: int
    sender: str
    def __init__(self, id: _Optional[str] = ..., deadline_ns: _Optional[int] = ..., sender: _Optional[str] = ...) -> None: ...

class CommandAnswer(_message.Message):
    __slots__ = ("id", "outcome", "code", "reason")
    ID_FIELD_NUMBER: _ClassVar[int]
    OUTCOME_FIELD_NUMBER: _ClassVar[int]
    CODE_FIELD_NUMBER: _ClassVar[int]
    REASON_FIELD_NUMBER: _ClassVar[int]
    id: str
    outcome: Outcome
    code: str
    reason: str
    def __init__(self, id: _Optional[str] = ..., outcome: _Optional[_Union[Outcome, str]] = ..., code: _Optional[str] = ..., reason: _Optional[str] = ...) -> None: ...

class CommandRecord(_message.Message):
    __slots__ = ("topic", "encoding", "payload", "received_ns", "answer")
    TOPIC_FIELD_NUMBER: _ClassVar[int]
    ENCODING_FIELD_NUMBER: _ClassVar[int]
    PAYLOAD_FIELD_NUMBER: _ClassVar[int]
    RECEIVED_NS_FIELD_NUMBER: _ClassVar[int]
    ANSWER_FIELD_NUMBER: _ClassVar[int]
    topic: str
    encoding: str
    payload: bytes
    received_ns: int
    answer: CommandAnswer
    def __init__(self, topic: _Optional[str] = ..., encoding: _Optional[str] = ..., payload: _Optional[bytes] = ..., received_ns: _Optional[int] = ..., answer: _Optional[_Union[CommandAnswer, _Mapping]] = ...) -> None: ...

class InputHealth(_message.Message):
    __slots__ = ("topic", "rate_hz", "age_ms", "received", "dropped", "missed", "refused")
    TOPIC_FIELD_NUMBER: _ClassVar[int]
    RATE_HZ_FIELD_NUMBER: _ClassVar[int]
    AGE_MS_FIELD_NUMBER: _ClassVar[int]
    RECEIVED_FIELD_NUMBER: _ClassVar[int]
    DROPPED_FIELD_NUMBER: _ClassVar[int]
    MISSED_FIELD_NUMBER: _ClassVar[int]
    REFUSED_FIELD_NUMBER: _ClassVar[int]
    topic: str
    rate_hz: float
    age_ms: float
    received: int
    dropped: int
    missed: int
    refused: int
    def __init__(self, topic: _Optional[str] = ..., rate_hz: _Optional[float] = ..., age_ms: _Optional[float] = ..., received: _Optional[int] = ..., dropped: _Optional[int] = ..., missed: _Optional[int] = ..., refused: _Optional[int] = ...) -> None: ...

class OutputHealth(_message.Message):
    __slots__ = ("topic", "rate_hz", "published")
    TOPIC_FIELD_NUMBER: _ClassVar[int]
    RATE_HZ_FIELD_NUMBER: _ClassVar[int]
    PUBLISHED_FIELD_NUMBER: _ClassVar[int]
    topic: str
    rate_hz: float
    published: int
    def __init__(self, topic: _Optional[str] = ..., rate_hz: _Optional[float] = ..., published: _Optional[int] = ...) -> None: ...

class AgentHealth(_message.Message):
    __slots__ = ("agent", "instance", "host", "version", "config_hash", "at_ns", "uptime_s", "heartbeat", "step_ms_p50", "step_ms_p99", "inputs", "outputs", "fault", "processor_share", "resident_bytes")
    AGENT_FIELD_NUMBER: _ClassVar[int]
    INSTANCE_FIELD_NUMBER: _ClassVar[int]
    HOST_FIELD_NUMBER: _ClassVar[int]
    VERSION_FIELD_NUMBER: _ClassVar[int]
    CONFIG_HASH_FIELD_NUMBER: _ClassVar[int]
    AT_NS_FIELD_NUMBER: _ClassVar[int]
    UPTIME_S_FIELD_NUMBER: _ClassVar[int]
    HEARTBEAT_FIELD_NUMBER: _ClassVar[int]
    STEP_MS_P50_FIELD_NUMBER: _ClassVar[int]
    STEP_MS_P99_FIELD_NUMBER: _ClassVar[int]
    INPUTS_FIELD_NUMBER: _ClassVar[int]
    OUTPUTS_FIELD_NUMBER: _ClassVar[int]
    FAULT_FIELD_NUMBER: _ClassVar[int]
    PROCESSOR_SHARE_FIELD_NUMBER: _ClassVar[int]
    RESIDENT_BYTES_FIELD_NUMBER: _ClassVar[int]
    agent: str
    instance: str
    host: str
    version: str
    config_hash: str
    at_ns: int
    uptime_s: float
    heartbeat: int
    step_ms_p50: float
    step_ms_p99: float
    inputs: _containers.RepeatedCompositeFieldContainer[InputHealth]
    outputs: _containers.RepeatedCompositeFieldContainer[OutputHealth]
    fault: str
    processor_share: float
    resident_bytes: int
    def __init__(self, agent: _Optional[str] = ..., instance: _Optional[str] = ..., host: _Optional[str] = ..., version: _Optional[str] = ..., config_hash: _Optional[str] = ..., at_ns: _Optional[int] = ..., uptime_s: _Optional[float] = ..., heartbeat: _Optional[int] = ..., step_ms_p50: _Optional[float] = ..., step_ms_p99: _Optional[float] = ..., inputs: _Optional[_Iterable[_Union[InputHealth, _Mapping]]] = ..., outputs: _Optional[_Iterable[_Union[OutputHealth, _Mapping]]] = ..., fault: _Optional[str] = ..., processor_share: _Optional[float] = ..., resident_bytes: _Optional[int] = ...) -> None: ...

class LogRecord(_message.Message):
    __slots__ = ("at_ns", "agent", "instance", "level", "text")
    AT_NS_FIELD_NUMBER: _ClassVar[int]
    AGENT_FIELD_NUMBER: _ClassVar[int]
    INSTANCE_FIELD_NUMBER: _ClassVar[int]
    LEVEL_FIELD_NUMBER: _ClassVar[int]
    TEXT_FIELD_NUMBER: _ClassVar[int]
    at_ns: int
    agent: str
    instance: str
    level: LogLevel
    text: str
    def __init__(self, at_ns: _Optional[int] = ..., agent: _Optional[str] = ..., instance: _Optional[str] = ..., level: _Optional[_Union[LogLevel, str]] = ..., text: _Optional[str] = ...) -> None: ...

class ClockReading(_message.Message):
    __slots__ = ("host", "at_ns")
    HOST_FIELD_NUMBER: _ClassVar[int]
    AT_NS_FIELD_NUMBER: _ClassVar[int]
    host: str
    at_ns: int
    def __init__(self, host: _Optional[str] = ..., at_ns: _Optional[int] = ...) -> None: ...

class ReplayClock(_message.Message):
    __slots__ = ("now_ns", "rate")
    NOW_NS_FIELD_NUMBER: _ClassVar[int]
    RATE_FIELD_NUMBER: _ClassVar[int]
    now_ns: int
    rate: float
    def __init__(self, now_ns: _Optional[int] = ..., rate: _Optional[float] = ...) -> None: ...

class Progress(_message.Message):
    __slots__ = ("listens", "handled", "published")
    LISTENS_FIELD_NUMBER: _ClassVar[int]
    HANDLED_FIELD_NUMBER: _ClassVar[int]
    PUBLISHED_FIELD_NUMBER: _ClassVar[int]
    listens: str
    handled: _containers.RepeatedCompositeFieldContainer[Consumed]
    published: _containers.RepeatedCompositeFieldContainer[Consumed]
    def __init__(self, listens: _Optional[str] = ..., handled: _Optional[_Iterable[_Union[Consumed, _Mapping]]] = ..., published: _Optional[_Iterable[_Union[Consumed, _Mapping]]] = ...) -> None: ...

class SettableParameter(_message.Message):
    __slots__ = ("name", "allowed", "is_set")
    NAME_FIELD_NUMBER: _ClassVar[int]
    ALLOWED_FIELD_NUMBER: _ClassVar[int]
    IS_SET_FIELD_NUMBER: _ClassVar[int]
    name: str
    allowed: str
    is_set: bool
    def __init__(self, name: _Optional[str] = ..., allowed: _Optional[str] = ..., is_set: _Optional[bool] = ...) -> None: ...

class AgentConfiguration(_message.Message):
    __slots__ = ("agent", "instance", "at_ns", "parameters", "settable", "config_hash")
    AGENT_FIELD_NUMBER: _ClassVar[int]
    INSTANCE_FIELD_NUMBER: _ClassVar[int]
    AT_NS_FIELD_NUMBER: _ClassVar[int]
    PARAMETERS_FIELD_NUMBER: _ClassVar[int]
    SETTABLE_FIELD_NUMBER: _ClassVar[int]
    CONFIG_HASH_FIELD_NUMBER: _ClassVar[int]
    agent: str
    instance: str
    at_ns: int
    parameters: str
    settable: _containers.RepeatedCompositeFieldContainer[SettableParameter]
    config_hash: str
    def __init__(self, agent: _Optional[str] = ..., instance: _Optional[str] = ..., at_ns: _Optional[int] = ..., parameters: _Optional[str] = ..., settable: _Optional[_Iterable[_Union[SettableParameter, _Mapping]]] = ..., config_hash: _Optional[str] = ...) -> None: ...

class SetParameter(_message.Message):
    __slots__ = ("header", "name", "value")
    HEADER_FIELD_NUMBER: _ClassVar[int]
    NAME_FIELD_NUMBER: _ClassVar[int]
    VALUE_FIELD_NUMBER: _ClassVar[int]
    header: CommandHeader
    name: str
    value: str
    def __init__(self, header: _Optional[_Union[CommandHeader, _Mapping]] = ..., name: _Optional[str] = ..., value: _Optional[str] = ...) -> None: ...

class TopicOverride(_message.Message):
    __slots__ = ("topic", "setting", "value")
    TOPIC_FIELD_NUMBER: _ClassVar[int]
    SETTING_FIELD_NUMBER: _ClassVar[int]
    VALUE_FIELD_NUMBER: _ClassVar[int]
    topic: str
    setting: str
    value: str
    def __init__(self, topic: _Optional[str] = ..., setting: _Optional[str] = ..., value: _Optional[str] = ...) -> None: ...

class RigSection(_message.Message):
    __slots__ = ("name", "digest")
    NAME_FIELD_NUMBER: _ClassVar[int]
    DIGEST_FIELD_NUMBER: _ClassVar[int]
    name: str
    digest: str
    def __init__(self, name: _Optional[str] = ..., digest: _Optional[str] = ...) -> None: ...

class AgentFacts(_message.Message):
    __slots__ = ("agent", "instance", "host", "at_ns", "version", "schemas_hash", "config_hash", "python", "zenoh", "shared_memory", "shared_memory_reason", "realtime_asked", "realtime_granted", "realtime_reason", "writes_to", "disk_free_bytes", "calibrated_ns", "certificate_expires_ns", "processor_s", "resident_bytes", "overrides", "rig_sections")
    AGENT_FIELD_NUMBER: _ClassVar[int]
    INSTANCE_FIELD_NUMBER: _ClassVar[int]
    HOST_FIELD_NUMBER: _ClassVar[int]
    AT_NS_FIELD_NUMBER: _ClassVar[int]
    VERSION_FIELD_NUMBER: _ClassVar[int]
    SCHEMAS_HASH_FIELD_NUMBER: _ClassVar[int]
    CONFIG_HASH_FIELD_NUMBER: _ClassVar[int]
    PYTHON_FIELD_NUMBER: _ClassVar[int]
    ZENOH_FIELD_NUMBER: _ClassVar[int]
    SHARED_MEMORY_FIELD_NUMBER: _ClassVar[int]
    SHARED_MEMORY_REASON_FIELD_NUMBER: _ClassVar[int]
    REALTIME_ASKED_FIELD_NUMBER: _ClassVar[int]
    REALTIME_GRANTED_FIELD_NUMBER: _ClassVar[int]
    REALTIME_REASON_FIELD_NUMBER: _ClassVar[int]
    WRITES_TO_FIELD_NUMBER: _ClassVar[int]
    DISK_FREE_BYTES_FIELD_NUMBER: _ClassVar[int]
    CALIBRATED_NS_FIELD_NUMBER: _ClassVar[int]
    CERTIFICATE_EXPIRES_NS_FIELD_NUMBER: _ClassVar[int]
    PROCESSOR_S_FIELD_NUMBER: _ClassVar[int]
    RESIDENT_BYTES_FIELD_NUMBER: _ClassVar[int]
    OVERRIDES_FIELD_NUMBER: _ClassVar[int]
    RIG_SECTIONS_FIELD_NUMBER: _ClassVar[int]
    agent: str
    instance: str
    host: str
    at_ns: int
    version: str
    schemas_hash: str
    config_hash: str
    python: str
    zenoh: str
    shared_memory: bool
    shared_memory_reason: str
    realtime_asked: int
    realtime_granted: int
    realtime_reason: str
    writes_to: str
    disk_free_bytes: int
    calibrated_ns: int
    certificate_expires_ns: int
    processor_s: float
    resident_bytes: int
    overrides: _containers.RepeatedCompositeFieldContainer[TopicOverride]
    rig_sections: _containers.RepeatedCompositeFieldContainer[RigSection]
    def __init__(self, agent: _Optional[str] = ..., instance: _Optional[str] = ..., host: _Optional[str] = ..., at_ns: _Optional[int] = ..., version: _Optional[str] = ..., schemas_hash: _Optional[str] = ..., config_hash: _Optional[str] = ..., python: _Optional[str] = ..., zenoh: _Optional[str] = ..., shared_memory: _Optional[bool] = ..., shared_memory_reason: _Optional[str] = ..., realtime_asked: _Optional[int] = ..., realtime_granted: _Optional[int] = ..., realtime_reason: _Optional[str] = ..., writes_to: _Optional[str] = ..., disk_free_bytes: _Optional[int] = ..., calibrated_ns: _Optional[int] = ..., certificate_expires_ns: _Optional[int] = ..., processor_s: _Optional[float] = ..., resident_bytes: _Optional[int] = ..., overrides: _Optional[_Iterable[_Union[TopicOverride, _Mapping]]] = ..., rig_sections: _Optional[_Iterable[_Union[RigSection, _Mapping]]] = ...) -> None: ...

class HostClock(_message.Message):
    __slots__ = ("agent", "instance", "host", "ahead_ms", "within_ms")
    AGENT_FIELD_NUMBER: _ClassVar[int]
    INSTANCE_FIELD_NUMBER: _ClassVar[int]
    HOST_FIELD_NUMBER: _ClassVar[int]
    AHEAD_MS_FIELD_NUMBER: _ClassVar[int]
    WITHIN_MS_FIELD_NUMBER: _ClassVar[int]
    agent: str
    instance: str
    host: str
    ahead_ms: float
    within_ms: float
    def __init__(self, agent: _Optional[str] = ..., instance: _Optional[str] = ..., host: _Optional[str] = ..., ahead_ms: _Optional[float] = ..., within_ms: _Optional[float] = ...) -> None: ...

class HostClocks(_message.Message):
    __slots__ = ("at_ns", "clocks")
    AT_NS_FIELD_NUMBER: _ClassVar[int]
    CLOCKS_FIELD_NUMBER: _ClassVar[int]
    at_ns: int
    clocks: _containers.RepeatedCompositeFieldContainer[HostClock]
    def __init__(self, at_ns: _Optional[int] = ..., clocks: _Optional[_Iterable[_Union[HostClock, _Mapping]]] = ...) -> None: ...

class GraspGoal(_message.Message):
    __slots__ = ("header", "arm", "policy", "s", "pixel", "point_camera", "attempts")
    HEADER_FIELD_NUMBER: _ClassVar[int]
    ARM_FIELD_NUMBER: _ClassVar[int]
    POLICY_FIELD_NUMBER: _ClassVar[int]
    S_FIELD_NUMBER: _ClassVar[int]
    PIXEL_FIELD_NUMBER: _ClassVar[int]
    POINT_CAMERA_FIELD_NUMBER: _ClassVar[int]
    ATTEMPTS_FIELD_NUMBER: _ClassVar[int]
    header: CommandHeader
    arm: str
    policy: Policy
    s: float
    pixel: Array
    point_camera: Array
    attempts: int
    def __init__(self, header: _Optional[_Union[CommandHeader, _Mapping]] = ..., arm: _Optional[str] = ..., policy: _Optional[_Union[Policy, str]] = ..., s: _Optional[float] = ..., pixel: _Optional[_Union[Array, _Mapping]] = ..., point_camera: _Optional[_Union[Array, _Mapping]] = ..., attempts: _Optional[int] = ...) -> None: ...

class Arm(_message.Message):
    __slots__ = ("header", "arm", "plan_id", "challenge_ns", "pressed", "segments")
    HEADER_FIELD_NUMBER: _ClassVar[int]
    ARM_FIELD_NUMBER: _ClassVar[int]
    PLAN_ID_FIELD_NUMBER: _ClassVar[int]
    CHALLENGE_NS_FIELD_NUMBER: _ClassVar[int]
    PRESSED_FIELD_NUMBER: _ClassVar[int]
    SEGMENTS_FIELD_NUMBER: _ClassVar[int]
    header: CommandHeader
    arm: str
    plan_id: str
    challenge_ns: int
    pressed: bool
    segments: int
    def __init__(self, header: _Optional[_Union[CommandHeader, _Mapping]] = ..., arm: _Optional[str] = ..., plan_id: _Optional[str] = ..., challenge_ns: _Optional[int] = ..., pressed: _Optional[bool] = ..., segments: _Optional[int] = ...) -> None: ...

class Hold(_message.Message):
    __slots__ = ("header", "arm")
    HEADER_FIELD_NUMBER: _ClassVar[int]
    ARM_FIELD_NUMBER: _ClassVar[int]
    header: CommandHeader
    arm: str
    def __init__(self, header: _Optional[_Union[CommandHeader, _Mapping]] = ..., arm: _Optional[str] = ...) -> None: ...

class ChangeState(_message.Message):
    __slots__ = ("header", "arm", "word")
    HEADER_FIELD_NUMBER: _ClassVar[int]
    ARM_FIELD_NUMBER: _ClassVar[int]
    WORD_FIELD_NUMBER: _ClassVar[int]
    header: CommandHeader
    arm: str
    word: StateWord
    def __init__(self, header: _Optional[_Union[CommandHeader, _Mapping]] = ..., arm: _Optional[str] = ..., word: _Optional[_Union[StateWord, str]] = ...) -> None: ...

class Prompt(_message.Message):
    __slots__ = ("header", "pixel")
    HEADER_FIELD_NUMBER: _ClassVar[int]
    PIXEL_FIELD_NUMBER: _ClassVar[int]
    header: CommandHeader
    pixel: Array
    def __init__(self, header: _Optional[_Union[CommandHeader, _Mapping]] = ..., pixel: _Optional[_Union[Array, _Mapping]] = ...) -> None: ...

class Heartbeat(_message.Message):
    __slots__ = ("arm", "plan_id", "at_ns", "arming_id", "challenge_ns", "guard_challenge", "pressed")
    ARM_FIELD_NUMBER: _ClassVar[int]
    PLAN_ID_FIELD_NUMBER: _ClassVar[int]
    AT_NS_FIELD_NUMBER: _ClassVar[int]
    ARMING_ID_FIELD_NUMBER: _ClassVar[int]
    CHALLENGE_NS_FIELD_NUMBER: _ClassVar[int]
    GUARD_CHALLENGE_FIELD_NUMBER: _ClassVar[int]
    PRESSED_FIELD_NUMBER: _ClassVar[int]
    arm: str
    plan_id: str
    at_ns: int
    arming_id: str
    challenge_ns: int
    guard_challenge: int
    pressed: bool
    def __init__(self, arm: _Optional[str] = ..., plan_id: _Optional[str] = ..., at_ns: _Optional[int] = ..., arming_id: _Optional[str] = ..., challenge_ns: _Optional[int] = ..., guard_challenge: _Optional[int] = ..., pressed: _Optional[bool] = ...) -> None: ...

class Waypoint(_message.Message):
    __slots__ = ("T_camera_tool", "jaw_rad", "phase", "s")
    T_CAMERA_TOOL_FIELD_NUMBER: _ClassVar[int]
    JAW_RAD_FIELD_NUMBER: _ClassVar[int]
    PHASE_FIELD_NUMBER: _ClassVar[int]
    S_FIELD_NUMBER: _ClassVar[int]
    T_camera_tool: Array
    jaw_rad: float
    phase: Phase
    s: float
    def __init__(self, T_camera_tool: _Optional[_Union[Array, _Mapping]] = ..., jaw_rad: _Optional[float] = ..., phase: _Optional[_Union[Phase, str]] = ..., s: _Optional[float] = ...) -> None: ...

class Alternative(_message.Message):
    __slots__ = ("s_capture", "probability", "reason")
    S_CAPTURE_FIELD_NUMBER: _ClassVar[int]
    PROBABILITY_FIELD_NUMBER: _ClassVar[int]
    REASON_FIELD_NUMBER: _ClassVar[int]
    s_capture: float
    probability: float
    reason: str
    def __init__(self, s_capture: _Optional[float] = ..., probability: _Optional[float] = ..., reason: _Optional[str] = ...) -> None: ...

class TissueClearance(_message.Message):
    __slots__ = ("stamp", "unchecked", "known_share", "clearance_m", "deviation_m", "place_camera", "phase", "s")
    STAMP_FIELD_NUMBER: _ClassVar[int]
    UNCHECKED_FIELD_NUMBER: _ClassVar[int]
    KNOWN_SHARE_FIELD_NUMBER: _ClassVar[int]
    CLEARANCE_M_FIELD_NUMBER: _ClassVar[int]
    DEVIATION_M_FIELD_NUMBER: _ClassVar[int]
    PLACE_CAMERA_FIELD_NUMBER: _ClassVar[int]
    PHASE_FIELD_NUMBER: _ClassVar[int]
    S_FIELD_NUMBER: _ClassVar[int]
    stamp: FrameStamp
    unchecked: str
    known_share: float
    clearance_m: float
    deviation_m: float
    place_camera: Array
    phase: Phase
    s: float
    def __init__(self, stamp: _Optional[_Union[FrameStamp, _Mapping]] = ..., unchecked: _Optional[str] = ..., known_share: _Optional[float] = ..., clearance_m: _Optional[float] = ..., deviation_m: _Optional[float] = ..., place_camera: _Optional[_Union[Array, _Mapping]] = ..., phase: _Optional[_Union[Phase, str]] = ..., s: _Optional[float] = ...) -> None: ...

class ThreadClearance(_message.Message):
    __slots__ = ("obstructed", "clearance_m", "place_camera", "phase", "s")
    OBSTRUCTED_FIELD_NUMBER: _ClassVar[int]
    CLEARANCE_M_FIELD_NUMBER: _ClassVar[int]
    PLACE_CAMERA_FIELD_NUMBER: _ClassVar[int]
    PHASE_FIELD_NUMBER: _ClassVar[int]
    S_FIELD_NUMBER: _ClassVar[int]
    obstructed: str
    clearance_m: float
    place_camera: Array
    phase: Phase
    s: float
    def __init__(self, obstructed: _Optional[str] = ..., clearance_m: _Optional[float] = ..., place_camera: _Optional[_Union[Array, _Mapping]] = ..., phase: _Optional[_Union[Phase, str]] = ..., s: _Optional[float] = ...) -> None: ...

class ThreadAround(_message.Message):
    __slots__ = ("s", "points_camera", "covariance")
    S_FIELD_NUMBER: _ClassVar[int]
    POINTS_CAMERA_FIELD_NUMBER: _ClassVar[int]
    COVARIANCE_FIELD_NUMBER: _ClassVar[int]
    s: Array
    points_camera: Array
    covariance: Array
    def __init__(self, s: _Optional[_Union[Array, _Mapping]] = ..., points_camera: _Optional[_Union[Array, _Mapping]] = ..., covariance: _Optional[_Union[Array, _Mapping]] = ...) -> None: ...

class GraspPlan(_message.Message):
    __slots__ = ("plan_id", "arm", "goal_id", "stamp", "status", "reason", "policy", "s_goal", "s_capture", "probability", "slide_m", "waypoints", "alternatives", "tissue", "consumed", "thread", "attempt", "attempts", "policy_model", "goal", "around", "depth_m", "offset_camera", "offset_covariance", "maximum_frame_age_s", "continues")
    PLAN_ID_FIELD_NUMBER: _ClassVar[int]
    ARM_FIELD_NUMBER: _ClassVar[int]
    GOAL_ID_FIELD_NUMBER: _ClassVar[int]
    STAMP_FIELD_NUMBER: _ClassVar[int]
    STATUS_FIELD_NUMBER: _ClassVar[int]
    REASON_FIELD_NUMBER: _ClassVar[int]
    POLICY_FIELD_NUMBER: _ClassVar[int]
    S_GOAL_FIELD_NUMBER: _ClassVar[int]
    S_CAPTURE_FIELD_NUMBER: _ClassVar[int]
    PROBABILITY_FIELD_NUMBER: _ClassVar[int]
    SLIDE_M_FIELD_NUMBER: _ClassVar[int]
    WAYPOINTS_FIELD_NUMBER: _ClassVar[int]
    ALTERNATIVES_FIELD_NUMBER: _ClassVar[int]
    TISSUE_FIELD_NUMBER: _ClassVar[int]
    CONSUMED_FIELD_NUMBER: _ClassVar[int]
    THREAD_FIELD_NUMBER: _ClassVar[int]
    ATTEMPT_FIELD_NUMBER: _ClassVar[int]
    ATTEMPTS_FIELD_NUMBER: _ClassVar[int]
    POLICY_MODEL_FIELD_NUMBER: _ClassVar[int]
    GOAL_FIELD_NUMBER: _ClassVar[int]
    AROUND_FIELD_NUMBER: _ClassVar[int]
    DEPTH_M_FIELD_NUMBER: _ClassVar[int]
    OFFSET_CAMERA_FIELD_NUMBER: _ClassVar[int]
    OFFSET_COVARIANCE_FIELD_NUMBER: _ClassVar[int]
    MAXIMUM_FRAME_AGE_S_FIELD_NUMBER: _ClassVar[int]
    CONTINUES_FIELD_NUMBER: _ClassVar[int]
    plan_id: str
    arm: str
    goal_id: str
    stamp: FrameStamp
    status: Status
    reason: str
    policy: Policy
    s_goal: float
    s_capture: float
    probability: float
    slide_m: float
    waypoints: _containers.RepeatedCompositeFieldContainer[Waypoint]
    alternatives: _containers.RepeatedCompositeFieldContainer[Alternative]
    tissue: TissueClearance
    consumed: _containers.RepeatedCompositeFieldContainer[Consumed]
    thread: ThreadClearance
    attempt: int
    attempts: int
    policy_model: str
    goal: GraspGoal
    around: ThreadAround
    depth_m: float
    offset_camera: Array
    offset_covariance: Array
    maximum_frame_age_s: float
    continues: str
    def __init__(self, plan_id: _Optional[str] = ..., arm: _Optional[str] = ..., goal_id: _Optional[str] = ..., stamp: _Optional[_Union[FrameStamp, _Mapping]] = ..., status: _Optional[_Union[Status, str]] = ..., reason: _Optional[str] = ..., policy: _Optional[_Union[Policy, str]] = ..., s_goal: _Optional[float] = ..., s_capture: _Optional[float] = ..., probability: _Optional[float] = ..., slide_m: _Optional[float] = ..., waypoints: _Optional[_Iterable[_Union[Waypoint, _Mapping]]] = ..., alternatives: _Optional[_Iterable[_Union[Alternative, _Mapping]]] = ..., tissue: _Optional[_Union[TissueClearance, _Mapping]] = ..., consumed: _Optional[_Iterable[_Union[Consumed, _Mapping]]] = ..., thread: _Optional[_Union[ThreadClearance, _Mapping]] = ..., attempt: _Optional[int] = ..., attempts: _Optional[int] = ..., policy_model: _Optional[str] = ..., goal: _Optional[_Union[GraspGoal, _Mapping]] = ..., around: _Optional[_Union[ThreadAround, _Mapping]] = ..., depth_m: _Optional[float] = ..., offset_camera: _Optional[_Union[Array, _Mapping]] = ..., offset_covariance: _Optional[_Union[Array, _Mapping]] = ..., maximum_frame_age_s: _Optional[float] = ..., continues: _Optional[str] = ...) -> None: ...

class GraspCheck(_message.Message):
    __slots__ = ("plan_id", "arm", "goal_id", "verdict", "before", "after", "tool_moved_m", "thread_moved_m", "deviation_m", "held_probability", "attempt", "attempts", "next_plan_id", "sentence", "consumed")
    PLAN_ID_FIELD_NUMBER: _ClassVar[int]
    ARM_FIELD_NUMBER: _ClassVar[int]
    GOAL_ID_FIELD_NUMBER: _ClassVar[int]
    VERDICT_FIELD_NUMBER: _ClassVar[int]
    BEFORE_FIELD_NUMBER: _ClassVar[int]
    AFTER_FIELD_NUMBER: _ClassVar[int]
    TOOL_MOVED_M_FIELD_NUMBER: _ClassVar[int]
    THREAD_MOVED_M_FIELD_NUMBER: _ClassVar[int]
    DEVIATION_M_FIELD_NUMBER: _ClassVar[int]
    HELD_PROBABILITY_FIELD_NUMBER: _ClassVar[int]
    ATTEMPT_FIELD_NUMBER: _ClassVar[int]
    ATTEMPTS_FIELD_NUMBER: _ClassVar[int]
    NEXT_PLAN_ID_FIELD_NUMBER: _ClassVar[int]
    SENTENCE_FIELD_NUMBER: _ClassVar[int]
    CONSUMED_FIELD_NUMBER: _ClassVar[int]
    plan_id: str
    arm: str
    goal_id: str
    verdict: Checked
    before: FrameStamp
    after: FrameStamp
    tool_moved_m: float
    thread_moved_m: float
    deviation_m: float
    held_probability: float
    attempt: int
    attempts: int
    next_plan_id: str
    sentence: str
    consumed: _containers.RepeatedCompositeFieldContainer[Consumed]
    def __init__(self, plan_id: _Optional[str] = ..., arm: _Optional[str] = ..., goal_id: _Optional[str] = ..., verdict: _Optional[_Union[Checked, str]] = ..., before: _Optional[_Union[FrameStamp, _Mapping]] = ..., after: _Optional[_Union[FrameStamp, _Mapping]] = ..., tool_moved_m: _Optional[float] = ..., thread_moved_m: _Optional[float] = ..., deviation_m: _Optional[float] = ..., held_probability: _Optional[float] = ..., attempt: _Optional[int] = ..., attempts: _Optional[int] = ..., next_plan_id: _Optional[str] = ..., sentence: _Optional[str] = ..., consumed: _Optional[_Iterable[_Union[Consumed, _Mapping]]] = ...) -> None: ...

class RobotState(_message.Message):
    __slots__ = ("arm", "measured_ns", "mode", "T_base_tool", "joints", "jaw_rad", "T_camera_base", "plan_id", "consumed", "T_camera_base_registered", "kinematics", "correction_looked_ns", "challenge_ns", "guard_challenge", "maximum_frame_age_s", "is_real")
    ARM_FIELD_NUMBER: _ClassVar[int]
    MEASURED_NS_FIELD_NUMBER: _ClassVar[int]
    MODE_FIELD_NUMBER: _ClassVar[int]
    T_BASE_TOOL_FIELD_NUMBER: _ClassVar[int]
    JOINTS_FIELD_NUMBER: _ClassVar[int]
    JAW_RAD_FIELD_NUMBER: _ClassVar[int]
    T_CAMERA_BASE_FIELD_NUMBER: _ClassVar[int]
    PLAN_ID_FIELD_NUMBER: _ClassVar[int]
    CONSUMED_FIELD_NUMBER: _ClassVar[int]
    T_CAMERA_BASE_REGISTERED_FIELD_NUMBER: _ClassVar[int]
    KINEMATICS_FIELD_NUMBER: _ClassVar[int]
    CORRECTION_LOOKED_NS_FIELD_NUMBER: _ClassVar[int]
    CHALLENGE_NS_FIELD_NUMBER: _ClassVar[int]
    GUARD_CHALLENGE_FIELD_NUMBER: _ClassVar[int]
    MAXIMUM_FRAME_AGE_S_FIELD_NUMBER: _ClassVar[int]
    IS_REAL_FIELD_NUMBER: _ClassVar[int]
    arm: str
    measured_ns: int
    mode: RobotMode
    T_base_tool: Array
    joints: Array
    jaw_rad: float
    T_camera_base: Array
    plan_id: str
    consumed: _containers.RepeatedCompositeFieldContainer[Consumed]
    T_camera_base_registered: Array
    kinematics: str
    correction_looked_ns: int
    challenge_ns: int
    guard_challenge: int
    maximum_frame_age_s: float
    is_real: bool
    def __init__(self, arm: _Optional[str] = ..., measured_ns: _Optional[int] = ..., mode: _Optional[_Union[RobotMode, str]] = ..., T_base_tool: _Optional[_Union[Array, _Mapping]] = ..., joints: _Optional[_Union[Array, _Mapping]] = ..., jaw_rad: _Optional[float] = ..., T_camera_base: _Optional[_Union[Array, _Mapping]] = ..., plan_id: _Optional[str] = ..., consumed: _Optional[_Iterable[_Union[Consumed, _Mapping]]] = ..., T_camera_base_registered: _Optional[_Union[Array, _Mapping]] = ..., kinematics: _Optional[str] = ..., correction_looked_ns: _Optional[int] = ..., challenge_ns: _Optional[int] = ..., guard_challenge: _Optional[int] = ..., maximum_frame_age_s: _Optional[float] = ..., is_real: _Optional[bool] = ...) -> None: ...

class NeedleView(_message.Message):
    __slots__ = ("lines", "needle", "colour_bgr", "instruments")
    LINES_FIELD_NUMBER: _ClassVar[int]
    NEEDLE_FIELD_NUMBER: _ClassVar[int]
    COLOUR_BGR_FIELD_NUMBER: _ClassVar[int]
    INSTRUMENTS_FIELD_NUMBER: _ClassVar[int]
    lines: Centrelines
    needle: Array
    colour_bgr: Array
    instruments: Image
    def __init__(self, lines: _Optional[_Union[Centrelines, _Mapping]] = ..., needle: _Optional[_Union[Array, _Mapping]] = ..., colour_bgr: _Optional[_Union[Array, _Mapping]] = ..., instruments: _Optional[_Union[Image, _Mapping]] = ...) -> None: ...

class NeedleObservations(_message.Message):
    __slots__ = ("stamp", "camera", "left", "right", "consumed")
    STAMP_FIELD_NUMBER: _ClassVar[int]
    CAMERA_FIELD_NUMBER: _ClassVar[int]
    LEFT_FIELD_NUMBER: _ClassVar[int]
    RIGHT_FIELD_NUMBER: _ClassVar[int]
    CONSUMED_FIELD_NUMBER: _ClassVar[int]
    stamp: FrameStamp
    camera: RectifiedStereo
    left: NeedleView
    right: NeedleView
    consumed: _containers.RepeatedCompositeFieldContainer[Consumed]
    def __init__(self, stamp: _Optional[_Union[FrameStamp, _Mapping]] = ..., camera: _Optional[_Union[RectifiedStereo, _Mapping]] = ..., left: _Optional[_Union[NeedleView, _Mapping]] = ..., right: _Optional[_Union[NeedleView, _Mapping]] = ..., consumed: _Optional[_Iterable[_Union[Consumed, _Mapping]]] = ...) -> None: ...

class NeedlePose(_message.Message):
    __slots__ = ("stamp", "camera", "status", "reason", "T_camera_needle", "radius", "arc_rad", "covariance", "ends_seen", "swage_probability", "seen_rad", "residual_px", "consumed")
    STAMP_FIELD_NUMBER: _ClassVar[int]
    CAMERA_FIELD_NUMBER: _ClassVar[int]
    STATUS_FIELD_NUMBER: _ClassVar[int]
    REASON_FIELD_NUMBER: _ClassVar[int]
    T_CAMERA_NEEDLE_FIELD_NUMBER: _ClassVar[int]
    RADIUS_FIELD_NUMBER: _ClassVar[int]
    ARC_RAD_FIELD_NUMBER: _ClassVar[int]
    COVARIANCE_FIELD_NUMBER: _ClassVar[int]
    ENDS_SEEN_FIELD_NUMBER: _ClassVar[int]
    SWAGE_PROBABILITY_FIELD_NUMBER: _ClassVar[int]
    SEEN_RAD_FIELD_NUMBER: _ClassVar[int]
    RESIDUAL_PX_FIELD_NUMBER: _ClassVar[int]
    CONSUMED_FIELD_NUMBER: _ClassVar[int]
    stamp: FrameStamp
    camera: RectifiedStereo
    status: Status
    reason: str
    T_camera_needle: Array
    radius: float
    arc_rad: float
    covariance: Array
    ends_seen: Array
    swage_probability: float
    seen_rad: float
    residual_px: float
    consumed: _containers.RepeatedCompositeFieldContainer[Consumed]
    def __init__(self, stamp: _Optional[_Union[FrameStamp, _Mapping]] = ..., camera: _Optional[_Union[RectifiedStereo, _Mapping]] = ..., status: _Optional[_Union[Status, str]] = ..., reason: _Optional[str] = ..., T_camera_needle: _Optional[_Union[Array, _Mapping]] = ..., radius: _Optional[float] = ..., arc_rad: _Optional[float] = ..., covariance: _Optional[_Union[Array, _Mapping]] = ..., ends_seen: _Optional[_Union[Array, _Mapping]] = ..., swage_probability: _Optional[float] = ..., seen_rad: _Optional[float] = ..., residual_px: _Optional[float] = ..., consumed: _Optional[_Iterable[_Union[Consumed, _Mapping]]] = ...) -> None: ...

class ToolCandidate(_message.Message):
    __slots__ = ("twist", "covariance", "table", "expected", "fits", "quality", "residual_px")
    TWIST_FIELD_NUMBER: _ClassVar[int]
    COVARIANCE_FIELD_NUMBER: _ClassVar[int]
    TABLE_FIELD_NUMBER: _ClassVar[int]
    EXPECTED_FIELD_NUMBER: _ClassVar[int]
    FITS_FIELD_NUMBER: _ClassVar[int]
    QUALITY_FIELD_NUMBER: _ClassVar[int]
    RESIDUAL_PX_FIELD_NUMBER: _ClassVar[int]
    twist: Array
    covariance: Array
    table: Array
    expected: int
    fits: float
    quality: float
    residual_px: float
    def __init__(self, twist: _Optional[_Union[Array, _Mapping]] = ..., covariance: _Optional[_Union[Array, _Mapping]] = ..., table: _Optional[_Union[Array, _Mapping]] = ..., expected: _Optional[int] = ..., fits: _Optional[float] = ..., quality: _Optional[float] = ..., residual_px: _Optional[float] = ...) -> None: ...

class ToolCorrection(_message.Message):
    __slots__ = ("arm", "stamp", "measured_ns", "status", "reason", "T_correction", "pivot_camera", "tip_camera", "tip_off_m", "turned_rad", "tip_deviation_m", "turn_deviation_rad", "registered_left_px", "found_left_px", "found_right_px", "candidates", "attempts", "misses", "looks", "consumed")
    ARM_FIELD_NUMBER: _ClassVar[int]
    STAMP_FIELD_NUMBER: _ClassVar[int]
    MEASURED_NS_FIELD_NUMBER: _ClassVar[int]
    STATUS_FIELD_NUMBER: _ClassVar[int]
    REASON_FIELD_NUMBER: _ClassVar[int]
    T_CORRECTION_FIELD_NUMBER: _ClassVar[int]
    PIVOT_CAMERA_FIELD_NUMBER: _ClassVar[int]
    TIP_CAMERA_FIELD_NUMBER: _ClassVar[int]
    TIP_OFF_M_FIELD_NUMBER: _ClassVar[int]
    TURNED_RAD_FIELD_NUMBER: _ClassVar[int]
    TIP_DEVIATION_M_FIELD_NUMBER: _ClassVar[int]
    TURN_DEVIATION_RAD_FIELD_NUMBER: _ClassVar[int]
    REGISTERED_LEFT_PX_FIELD_NUMBER: _ClassVar[int]
    FOUND_LEFT_PX_FIELD_NUMBER: _ClassVar[int]
    FOUND_RIGHT_PX_FIELD_NUMBER: _ClassVar[int]
    CANDIDATES_FIELD_NUMBER: _ClassVar[int]
    ATTEMPTS_FIELD_NUMBER: _ClassVar[int]
    MISSES_FIELD_NUMBER: _ClassVar[int]
    LOOKS_FIELD_NUMBER: _ClassVar[int]
    CONSUMED_FIELD_NUMBER: _ClassVar[int]
    arm: str
    stamp: FrameStamp
    measured_ns: int
    status: ToolStatus
    reason: str
    T_correction: Array
    pivot_camera: Array
    tip_camera: Array
    tip_off_m: float
    turned_rad: float
    tip_deviation_m: float
    turn_deviation_rad: float
    registered_left_px: Array
    found_left_px: Array
    found_right_px: Array
    candidates: _containers.RepeatedCompositeFieldContainer[ToolCandidate]
    attempts: int
    misses: int
    looks: int
    consumed: _containers.RepeatedCompositeFieldContainer[Consumed]
    def __init__(self, arm: _Optional[str] = ..., stamp: _Optional[_Union[FrameStamp, _Mapping]] = ..., measured_ns: _Optional[int] = ..., status: _Optional[_Union[ToolStatus, str]] = ..., reason: _Optional[str] = ..., T_correction: _Optional[_Union[Array, _Mapping]] = ..., pivot_camera: _Optional[_Union[Array, _Mapping]] = ..., tip_camera: _Optional[_Union[Array, _Mapping]] = ..., tip_off_m: _Optional[float] = ..., turned_rad: _Optional[float] = ..., tip_deviation_m: _Optional[float] = ..., turn_deviation_rad: _Optional[float] = ..., registered_left_px: _Optional[_Union[Array, _Mapping]] = ..., found_left_px: _Optional[_Union[Array, _Mapping]] = ..., found_right_px: _Optional[_Union[Array, _Mapping]] = ..., candidates: _Optional[_Iterable[_Union[ToolCandidate, _Mapping]]] = ..., attempts: _Optional[int] = ..., misses: _Optional[int] = ..., looks: _Optional[int] = ..., consumed: _Optional[_Iterable[_Union[Consumed, _Mapping]]] = ...) -> None: ...

class ExecutionEvent(_message.Message):
    __slots__ = ("plan_id", "arm", "at_ns", "kind", "phase", "code", "reason", "arming_id", "consumed")
    PLAN_ID_FIELD_NUMBER: _ClassVar[int]
    ARM_FIELD_NUMBER: _ClassVar[int]
    AT_NS_FIELD_NUMBER: _ClassVar[int]
    KIND_FIELD_NUMBER: _ClassVar[int]
    PHASE_FIELD_NUMBER: _ClassVar[int]
    CODE_FIELD_NUMBER: _ClassVar[int]
    REASON_FIELD_NUMBER: _ClassVar[int]
    ARMING_ID_FIELD_NUMBER: _ClassVar[int]
    CONSUMED_FIELD_NUMBER: _ClassVar[int]
    plan_id: str
    arm: str
    at_ns: int
    kind: ExecutionKind
    phase: Phase
    code: str
    reason: str
    arming_id: str
    consumed: _containers.RepeatedCompositeFieldContainer[Consumed]
    def __init__(self, plan_id: _Optional[str] = ..., arm: _Optional[str] = ..., at_ns: _Optional[int] = ..., kind: _Optional[_Union[ExecutionKind, str]] = ..., phase: _Optional[_Union[Phase, str]] = ..., code: _Optional[str] = ..., reason: _Optional[str] = ..., arming_id: _Optional[str] = ..., consumed: _Optional[_Iterable[_Union[Consumed, _Mapping]]] = ...) -> None: ...

class SimulatorState(_message.Message):
    __slots__ = ("at_ns", "camera", "background", "colour", "seed", "distance_m", "radius_m", "knots", "control_points_camera", "held", "consumed")
    AT_NS_FIELD_NUMBER: _ClassVar[int]
    CAMERA_FIELD_NUMBER: _ClassVar[int]
    BACKGROUND_FIELD_NUMBER: _ClassVar[int]
    COLOUR_FIELD_NUMBER: _ClassVar[int]
    SEED_FIELD_NUMBER: _ClassVar[int]
    DISTANCE_M_FIELD_NUMBER: _ClassVar[int]
    RADIUS_M_FIELD_NUMBER: _ClassVar[int]
    KNOTS_FIELD_NUMBER: _ClassVar[int]
    CONTROL_POINTS_CAMERA_FIELD_NUMBER: _ClassVar[int]
    HELD_FIELD_NUMBER: _ClassVar[int]
    CONSUMED_FIELD_NUMBER: _ClassVar[int]
    at_ns: int
    camera: RectifiedStereo
    background: str
    colour: str
    seed: int
    distance_m: float
    radius_m: float
    knots: Array
    control_points_camera: Array
    held: float
    consumed: _containers.RepeatedCompositeFieldContainer[Consumed]
    def __init__(self, at_ns: _Optional[int] = ..., camera: _Optional[_Union[RectifiedStereo, _Mapping]] = ..., background: _Optional[str] = ..., colour: _Optional[str] = ..., seed: _Optional[int] = ..., distance_m: _Optional[float] = ..., radius_m: _Optional[float] = ..., knots: _Optional[_Union[Array, _Mapping]] = ..., control_points_camera: _Optional[_Union[Array, _Mapping]] = ..., held: _Optional[float] = ..., consumed: _Optional[_Iterable[_Union[Consumed, _Mapping]]] = ...) -> None: ...

class GraspJudgement(_message.Message):
    __slots__ = ("plan_id", "arm", "at_ns", "verdict", "s_caught", "slid_m", "error_m", "sentence", "peak_tissue_force_n", "slipped_m", "code", "consumed")
    PLAN_ID_FIELD_NUMBER: _ClassVar[int]
    ARM_FIELD_NUMBER: _ClassVar[int]
    AT_NS_FIELD_NUMBER: _ClassVar[int]
    VERDICT_FIELD_NUMBER: _ClassVar[int]
    S_CAUGHT_FIELD_NUMBER: _ClassVar[int]
    SLID_M_FIELD_NUMBER: _ClassVar[int]
    ERROR_M_FIELD_NUMBER: _ClassVar[int]
    SENTENCE_FIELD_NUMBER: _ClassVar[int]
    PEAK_TISSUE_FORCE_N_FIELD_NUMBER: _ClassVar[int]
    SLIPPED_M_FIELD_NUMBER: _ClassVar[int]
    CODE_FIELD_NUMBER: _ClassVar[int]
    CONSUMED_FIELD_NUMBER: _ClassVar[int]
    plan_id: str
    arm: str
    at_ns: int
    verdict: Verdict
    s_caught: float
    slid_m: float
    error_m: float
    sentence: str
    peak_tissue_force_n: float
    slipped_m: float
    code: str
    consumed: _containers.RepeatedCompositeFieldContainer[Consumed]
    def __init__(self, plan_id: _Optional[str] = ..., arm: _Optional[str] = ..., at_ns: _Optional[int] = ..., verdict: _Optional[_Union[Verdict, str]] = ..., s_caught: _Optional[float] = ..., slid_m: _Optional[float] = ..., error_m: _Optional[float] = ..., sentence: _Optional[str] = ..., peak_tissue_force_n: _Optional[float] = ..., slipped_m: _Optional[float] = ..., code: _Optional[str] = ..., consumed: _Optional[_Iterable[_Union[Consumed, _Mapping]]] = ...) -> None: ...
