"""Every command of the command line, a row each: what it is for, its options, and what carries it out."""

import importlib
from dataclasses import dataclass
from typing import Any

from agents.registry import AGENTS


@dataclass(frozen=True)
class Command:
    """One command.

    Fields:
        does: in a few words, for the list of all commands.
        options: `module:Class` of a dataclass, whose docstring is its help.
        runs: `module:function` that takes them and returns the exit status. Modules are those of this package, and are
            loaded when the command is given, for all together take seconds.
        on_rig: whether it takes the rig before them, as its configuration has it.
        of: what the options are made for, where a function makes them.
    """

    does: str
    options: str
    runs: str
    on_rig: bool = False
    of: str = ""

    def options_type(self) -> type:
        """The dataclass of its options."""
        found = loaded(self.options)
        return found(self.of) if self.of else found


def loaded(where: str) -> Any:
    """What a row names.

    Raises:
        ImportError: where its module cannot be loaded.
    """
    module, _, name = where.partition(":")
    return getattr(importlib.import_module(f"agents.cli.{module}"), name)


def _on_rig(does: str, options: str, runs: str, of: str = "") -> Command:
    return Command(does, options, runs, on_rig=True, of=of)


GROUPS: dict[str, dict[str, Command]] = {
    "to try it": {
        "demo": Command("a simulated grasp from image to judgement", "live.options:Demo", "demo.command:demo"),
        "play": _on_rig("the simulated field with the operator's page", "page.options:Play", "page.command:run"),
        "scenes": Command("stereo images of thread with known truth", "lab.options:Scenes", "lab.scenes:run"),
        "evaluate": Command(
            "the paper's experiment in simulation", "evaluate.options:Evaluate", "evaluate.command:run"
        ),
        "evaluate pulling": Command(
            "threads pulled through tissue in simulation", "evaluate.options:EvaluatePulling", "evaluate.pulling:run"
        ),
    },
    "images of your own": {
        "reconstruct": Command(
            "a stereo pair to a thread in 3D with its confidence",
            "reconstruct.options:Reconstruct",
            "reconstruct.command:run",
        ),
        "segment": Command(
            "where an image shows thread, needle, instrument", "reconstruct.options:Segment", "reconstruct.segment:run"
        ),
        "calibrate": _on_rig(
            "a stereo camera by images of a board, or check one",
            "calibrate.options:Calibrate",
            "calibrate.command:calibrate",
        ),
        "calibrate hand-eye": Command(
            "where an arm's base is before the camera", "calibrate.options:HandEye", "calibrate.hand_eye:run"
        ),
        "calibrate jaw": Command(
            "at which angle an instrument's jaw closes", "calibrate.options:Jaw", "calibrate.jaw:run"
        ),
        "track-tool": Command(
            "how far an arm's tool is from where its joints have it",
            "recordings.options:TrackTool",
            "track_tool.command:run",
        ),
    },
    "a rig": {
        "up": _on_rig("start router and all agents of this machine", "live.options:Up", "live.up:up"),
        **{
            f"run {kind.name.replace('_', '-')}": _on_rig(
                f"one agent, which {kind.does}", "live.options:agent_options", "live.agents:agent", of=kind.name
            )
            for kind in AGENTS
        },
        "router": _on_rig("what all agents connect to", "live.options:Router", "live.agents:router"),
        "guard": _on_rig("watch a real arm from its own computer", "live.options:Guard", "live.agents:guard"),
        "status": _on_rig("how it fares, live, and what is wrong", "live.options:RigStatus", "live.status:status"),
        "doctor": _on_rig(
            "what would keep it from running, and the remedy", "live.options:Doctor", "live.doctor:doctor"
        ),
        "set": _on_rig("a parameter of a running agent", "live.options:SetInAgent", "live.set:set_parameter"),
        "deploy": Command("what each host needs; rehearse it here", "lab.options:Deploy", "lab.deploy:run"),
        "emulate": Command("the computer of a robot, to try without one", "lab.options:Emulate", "lab.emulate:run"),
        "graph": Command("who says what to whom", "graph:Graph", "graph:run"),
    },
    "a grasp": {
        "page": _on_rig("the operator's page: see, click, arm, hold", "page.options:Page", "page.command:run"),
        "goal": _on_rig("ask for a grasp: where along the thread", "live.options:Goal", "live.command:goal"),
        "pull": _on_rig(
            "pull thread through tissue until its tail is so long",
            "live.options:PullThread",
            "live.pull:pull",
        ),
        "arm": _on_rig("arm a plan, and stand by it", "live.options:ArmPlan", "live.command:arm"),
        "hold": _on_rig(
            "have all arms stop where they are, disarmed", "live.options:HoldArm", "live.command:hold_arms"
        ),
        "state": _on_rig(
            "enable, disable, pause, resume or home a real arm",
            "live.options:ChangeArmState",
            "live.command:change_arm_state",
        ),
        "prompt": _on_rig("say which thread is meant", "live.options:PromptThread", "live.command:prompt_thread"),
        "experiment": _on_rig(
            "both policies at many goals, as in the paper",
            "experiment.options:Experiment",
            "experiment.command:experiment",
        ),
    },
    "recordings": {
        "record": _on_rig("every topic of a rig until stopped", "live.options:Record", "recordings.record:record"),
        "view": _on_rig("a running rig or a recording on Rerun", "live.options:View", "recordings.view:view"),
        "inspect": Command(
            "what one holds and lacks; compare two", "recordings.options:Inspect", "recordings.inspect:run"
        ),
        "export": Command("tables of one", "recordings.options:Export", "recordings.export:run"),
        "cut": Command("a stretch of one", "recordings.options:Cut", "recordings.cut:run"),
        "replay": Command("one on the live keys again", "recordings.options:Replay", "recordings.replay:run"),
        "recompute": Command(
            "what agents make of its inputs now, and what differs",
            "recordings.options:Recompute",
            "recordings.recompute:run",
        ),
    },
}
COMMANDS = {name: command for group in GROUPS.values() for name, command in group.items()}

FORMER: dict[tuple[str, str], str] = {
    **{(name.removeprefix("run "), ""): name for name in COMMANDS if name.startswith("run ")},
    ("calibrate-hand-eye", ""): "calibrate hand-eye",
    ("replay", "--through"): "recompute --through",
    ("prompt", "--at"): "prompt --pixel U V",
    ("reconstruct", "--at"): "reconstruct --pixel U V",
}
"""What a command, or one with an option, was called until 0.2.0, and what says the same now."""
