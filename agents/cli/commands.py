"""Every command of the command line, a row each: its options, and what carries it out."""

from dataclasses import dataclass

from agents.cli.calibrate.hand_eye_options import HandEye
from agents.cli.calibrate.options import Calibrate
from agents.cli.evaluate.options import Evaluate
from agents.cli.experiment.options import Experiment
from agents.cli.graph.options import Graph
from agents.cli.lab.emulate_options import Emulate
from agents.cli.lab.options import Deploy
from agents.cli.lab.scenes_options import Scenes
from agents.cli.live import options as live
from agents.cli.page.options import Page, Play
from agents.cli.reconstruct.options import Reconstruct
from agents.cli.recordings.options import Cut, Export, Inspect, Replay, TrackTool
from agents.cli.segment.options import Segment
from agents.registry import NAMES


@dataclass(frozen=True)
class Command:
    """One command.

    Fields:
        options: a dataclass, whose docstring is its help.
        runs: `module:function` that takes them and returns the exit status; loaded when the command is given, for all
            together take seconds.
        on_rig: whether it takes the rig before them, as its configuration has it.
    """

    options: type
    runs: str
    on_rig: bool = False


def _on_rig(options: type, runs: str) -> Command:
    return Command(options, runs, on_rig=True)


AGENT = "agents.cli.live.agents:agent"
COMMANDS: dict[str, Command] = {
    "reconstruct": Command(Reconstruct, "agents.cli.reconstruct.command:run"),
    "segment": Command(Segment, "agents.cli.segment.command:run"),
    "demo": Command(live.Demo, "agents.cli.demo.command:demo"),
    "up": _on_rig(live.Up, "agents.cli.running.up:up"),
    "goal": _on_rig(live.Goal, "agents.cli.live.command:goal"),
    "arm": _on_rig(live.ArmPlan, "agents.cli.live.command:arm"),
    "experiment": _on_rig(Experiment, "agents.cli.experiment.command:experiment"),
    "hold": _on_rig(live.HoldArm, "agents.cli.live.command:hold_arm"),
    "state": _on_rig(live.ChangeArmState, "agents.cli.live.command:change_arm_state"),
    "prompt": _on_rig(live.PromptThread, "agents.cli.live.command:prompt_thread"),
    "set": _on_rig(live.SetInAgent, "agents.cli.live.set:set_parameter"),
    "status": _on_rig(live.RigStatus, "agents.cli.status.command:status"),
    "doctor": _on_rig(live.Doctor, "agents.cli.doctor.command:doctor"),
    "calibrate": _on_rig(Calibrate, "agents.cli.calibrate.command:calibrate"),
    "router": _on_rig(live.Router, "agents.cli.running.router:run_router"),
    **{name.replace("_", "-"): _on_rig(live.agent_options(name), AGENT) for name in NAMES},
    "guard": _on_rig(live.Guard, "agents.cli.running.guard:guard"),
    "record": _on_rig(live.Record, "agents.cli.recordings.record:record"),
    "view": _on_rig(live.View, "agents.cli.recordings.view:view"),
    "page": Command(Page, "agents.cli.page.command:run"),
    "play": Command(Play, "agents.cli.page.command:run"),
    "replay": Command(Replay, "agents.cli.recordings.replay:run"),
    "inspect": Command(Inspect, "agents.cli.recordings.inspect:run"),
    "export": Command(Export, "agents.cli.recordings.export:run"),
    "cut": Command(Cut, "agents.cli.recordings.cut:run"),
    "track-tool": Command(TrackTool, "agents.cli.track_tool.command:run"),
    "deploy": Command(Deploy, "agents.cli.lab.deploy:run"),
    "scenes": Command(Scenes, "agents.cli.lab.scenes:run"),
    "evaluate": Command(Evaluate, "agents.cli.evaluate.command:run"),
    "emulate": Command(Emulate, "agents.cli.lab.emulate:run"),
    "calibrate-hand-eye": Command(HandEye, "agents.cli.calibrate.hand_eye:run"),
    "graph": Command(Graph, "agents.cli.graph.command:run"),
}


def command_of(options: object) -> Command:
    """The command that these are options of."""
    return next(command for command in COMMANDS.values() if command.options is type(options))
