"""How the golden recordings came about: `python -m tests.goldens.record NAME ...`, where another scene is wanted.

A moment of the simulated field, filmed at a quarter of the demo's pixels, with a goal of each policy at its end. Only
what perception, reconstruction and planner are fed and say is kept. Who only changed these runs `make bless` instead,
which leaves images and goals as they are.
"""

import sys
from pathlib import Path

from agents.camera.agent import CameraConfig, SceneCamera
from agents.camera.scene_source import SceneSource, calibration_of
from agents.cli.recordings.recompute import write_recording
from agents.configuration.rig import PerceptionSection, PlannerSection, ReconstructionSection, RigConfig
from agents.launch.builders import build
from agents.robot_bridge.agent import RobotBridge, RobotBridgeConfig
from agents.robot_bridge.simulated import SimulatedPsm
from agents.simulator.agent import Simulator, SimulatorConfig
from schemas import topics
from schemas.codec import decode
from schemas.messages import CommandHeader, GraspGoal, GraspPlan, Policy, RectifiedStereo, Status
from shared.recording.mcap_file import Note
from shared.runtime.replay import Lockstep

RIG = "golden"
SMALL = RectifiedStereo(480, 270, 500.0, 500.0, 239.5, 134.5, 5.5e-3, 1.0)
KEPT = (
    topics.FRAMES,
    topics.CALIBRATION,
    topics.OBSERVATIONS,
    topics.SURFACE,
    topics.THREAD,
    topics.ROBOT_STATE,
    topics.COMMANDS,
    topics.PLAN,
)
SCENES = {
    "tissue": (SimulatorConfig(seed=3, config="medium", background="tissue", distance_mm=85.0, camera=SMALL), 0.5),
    "crossing": (SimulatorConfig(seed=6, config="crossing", background="plain", colour="blue", camera=SMALL), 0.3),
}
"""What is filmed, and for how many seconds.

Scenes in which another processor's rounding decides nothing: points that move by 1e-4 px move these curves by 2 um, and
that of a crossing with seed 2 by 0.5 mm, at an end."""
HERE = Path(__file__).parent
RIG_CONFIG = RigConfig(
    rig=RIG, perception=PerceptionSection(), reconstruction=ReconstructionSection(), planner=PlannerSection()
)


def session(scene, seconds, rate_hz=5.0, jpeg_quality=75):
    """Everything that was published; frames at so many a second."""
    config = CameraConfig(rate_hz=rate_hz, jpeg_quality=jpeg_quality)
    lockstep = Lockstep(
        Simulator(scene),
        RobotBridge(RobotBridgeConfig(tick_hz=10.0), SimulatedPsm()),
        SceneCamera(SceneSource().render, lambda state: calibration_of(state.camera), config),
        *(build(RIG_CONFIG, kind, "main") for kind in ("perception", "reconstruction", "planner")),
        rig=RIG,
    )
    lockstep.run(seconds)
    for number, policy in enumerate(Policy):
        header = CommandHeader(f"goal-{number}", lockstep.now_ns + 10**9, "golden")
        lockstep.command(topics.GOAL, GraspGoal(header, "psm1", policy, 0.5, None, None))
    return lockstep


def main(names):
    for name in names or SCENES:
        made = session(*SCENES[name])
        plans = [
            decode(GraspPlan, entry.payload) for entry in made.entries if topics.topic_of(entry.key) is topics.PLAN
        ]
        kept = [entry for entry in made.entries if topics.topic_of(entry.key) in KEPT]
        path = HERE / f"{name}.mcap"
        text = RIG_CONFIG.model_dump_json(indent=1, exclude_none=True)
        write_recording(path, kept, (Note("run", {"rig": RIG}),), {"configuration.json": text.encode()})
        good = sum(plan.status is Status.OK for plan in plans)
        print(f"{path}: {len(kept)} messages, {good} of {len(plans)} plans, {path.stat().st_size} bytes")


if __name__ == "__main__":
    main(sys.argv[1:])
