"""The messages, as frozen dataclasses of arrays that are checked once, when they are made.

SI units where a name is silent, except that lengths of a calibration, and of everything measured with it, are in
the calibration's own unit: `metres_per_unit` says what that is, None where nobody knows. Points carry their frame;
`camera` is the rectified left camera in OpenCV's axes (x right, y down, z away). Shapes stand in the annotations.

`consumed` lists the messages that an output was made from. The runtime fills it in, so that a replay can feed exactly
those again.
"""

from schemas.messages.grasping import (
    Alternative,
    Arm,
    ExecutionEvent,
    ExecutionKind,
    GraspGoal,
    GraspPlan,
    Heartbeat,
    Hold,
    Phase,
    Policy,
    Prompt,
    RobotMode,
    RobotState,
    Waypoint,
)
from schemas.messages.imaging import (
    ROTATION_TOLERANCE,
    FrameStamp,
    Image,
    ImageEncoding,
    RectifiedStereo,
    StereoCalibration,
    StereoFrame,
)
from schemas.messages.running import (
    AgentHealth,
    ClockReading,
    CommandAnswer,
    CommandHeader,
    CommandRecord,
    Consumed,
    InputHealth,
    LogLevel,
    LogRecord,
    Outcome,
    OutputHealth,
    Progress,
    ReplayClock,
)
from schemas.messages.simulation import (
    GraspJudgement,
    SimulatorState,
    Verdict,
)
from schemas.messages.surface import TissueSurface
from schemas.messages.thread import (
    Centrelines,
    Crossing,
    Judgement,
    Over,
    ReliabilityRegions,
    Severity,
    Status,
    ThreadObservations,
    ThreadReconstruction,
    ThreadTrack,
    TrackStep,
    no_centrelines,
)

__all__ = [
    "ROTATION_TOLERANCE",
    "AgentHealth",
    "Alternative",
    "Arm",
    "Centrelines",
    "ClockReading",
    "CommandAnswer",
    "CommandHeader",
    "CommandRecord",
    "Consumed",
    "Crossing",
    "ExecutionEvent",
    "ExecutionKind",
    "FrameStamp",
    "GraspGoal",
    "GraspJudgement",
    "GraspPlan",
    "Heartbeat",
    "Hold",
    "Image",
    "ImageEncoding",
    "InputHealth",
    "Judgement",
    "LogLevel",
    "LogRecord",
    "Outcome",
    "OutputHealth",
    "Over",
    "Phase",
    "Policy",
    "Progress",
    "Prompt",
    "RectifiedStereo",
    "ReliabilityRegions",
    "ReplayClock",
    "RobotMode",
    "RobotState",
    "Severity",
    "SimulatorState",
    "Status",
    "StereoCalibration",
    "StereoFrame",
    "ThreadObservations",
    "ThreadReconstruction",
    "ThreadTrack",
    "TissueSurface",
    "TrackStep",
    "Verdict",
    "Waypoint",
    "no_centrelines",
]
