"""What the robot bridge must stand: a function for each kind of plan or command that is bad, or comes at a bad time."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, TypeVar

import numpy as np

from agents.robot_bridge.config import RobotBridgeError
from agents.robot_bridge.dvrk.set_points import SETTLES_NS
from schemas.checks import MessageError
from schemas.codec import decode, encode
from schemas.messages import (
    ChangeState,
    CommandHeader,
    FrameNotice,
    FrameStamp,
    GraspPlan,
    Outcome,
    ReplayClock,
    StateWord,
    Status,
    Waypoint,
)
from schemas.topics import CHANGE_STATE, FRAME_NOTICE, REPLAY_CLOCK
from shared.rigid_transforms import exp_so3, transform
from shared.ros import crtk
from shared.ros.types import STRING
from shared.ros.types import encode as ros_bytes
from shared.ros.types import message as ros_message
from shared.runtime.agent import Received
from tests.rigs.robot.hostile_plans import Found, any_plan, in_motion, set_out, waypoints
from tests.rigs.robot.world import EPOCH_NS, NAME, RIG_ARM, SECOND_NS, TICK_NS, World

T = TypeVar("T")
WORDS, STOPPING = tuple(StateWord), (StateWord.PAUSE, StateWord.DISABLE)


def _one(rng: np.random.Generator, of: Sequence[T]) -> T:
    return of[int(rng.integers(len(of)))]


def _as_it_comes(world: World, rng: np.random.Generator) -> Found:
    """A plan that may be good."""
    return Found("any plan", in_motion(world, rng, 120), True)


def _far_jumps(world: World, rng: np.random.Generator) -> Found:
    """Waypoints far from each other, any way round, or all but the same."""
    points = list(waypoints(rng, int(rng.integers(2, 12))))
    for index, point in enumerate(points):
        pose = point.T_camera_tool
        match int(rng.integers(3)):
            case 0:
                pose = transform(exp_so3(rng.normal(size=3) * 3), rng.uniform((-0.1, -0.08, 0.0), (0.1, 0.08, 0.16)))
            case 1:
                pose = pose + 1e-12 * np.eye(4, k=3)
            case _:
                pass
        points[index] = Waypoint(pose, float(rng.uniform(-0.69, 1.39)), point.phase, None)
    plan = any_plan(world, rng, waypoints=tuple(points))
    return Found("far jumps", set_out(world, plan, int(rng.integers(1, 80))), True)


def _bad_numbers(world: World, rng: np.random.Generator) -> Found:
    """A number of a waypoint that no arm can go to; past the codec, which would refuse most."""
    points = list(waypoints(rng))
    index = int(rng.integers(len(points)))
    told = vars(points[index]) | {"T_camera_tool": points[index].T_camera_tool.copy()}
    bad = _one(rng, [np.nan, np.inf, -np.inf, 1e308, -1e9, 10.0])
    if rng.random() < 0.3:
        told["jaw_rad"] = float(bad)
    else:
        told["T_camera_tool"][tuple(rng.integers(0, (3, 4)))] = bad
    points[index] = object.__new__(Waypoint)
    vars(points[index]).update(told)
    plan = any_plan(world, rng)
    vars(plan)["waypoints"] = tuple(points)
    return Found("bad numbers", set_out(world, plan, 20), False)


def _bad_bytes(world: World, rng: np.random.Generator) -> Found:
    """A plan of which some bytes are others."""
    data = bytearray(encode(any_plan(world, rng)))
    for _ in range(int(rng.integers(1, 6))):
        data[rng.integers(len(data))] = rng.integers(256)
    try:
        plan = decode(GraspPlan, bytes(data))
    except MessageError:
        return Found("bad bytes", False, True)
    return Found("bad bytes", set_out(world, plan, int(rng.integers(1, 60))), True)


def _not_now(world: World, rng: np.random.Generator) -> Found:
    """A plan that is too old, of the future, for another arm, rejected, or too long."""
    old_ns = world.now_ns - int(rng.integers(31, 10_000)) * SECOND_NS
    coming_ns = world.now_ns + int(rng.integers(1, 10_000)) * SECOND_NS
    changes: list[dict[str, Any]] = [
        {"stamp": FrameStamp(1, old_ns, old_ns, "c")},
        {"stamp": FrameStamp(1, world.now_ns, old_ns, "c")},
        {"stamp": FrameStamp(1, coming_ns, coming_ns, "c")},
        {"arm": "psm2"},
        {"status": Status.FAILED, "reason": "no", "waypoints": ()},
        {"waypoints": waypoints(rng, 1) * 1001},
    ]
    return Found("not now", set_out(world, any_plan(world, rng, **_one(rng, changes)), 20), False)


def _replayed_command(world: World, rng: np.random.Generator) -> Found:
    """An unknown plan, or one for another arm or another bridge."""
    plan = any_plan(world, rng)
    of: list[dict[str, str]] = [{"plan_id": "nobody knows it"}, {"arm": "psm2"}, {"instance": "psm2"}]
    world.publish(plan)
    answer = world.arm(**{"plan_id": plan.plan_id} | _one(rng, of))
    world.tick(5)
    return Found("replayed command", answer is None or answer.outcome is Outcome.ACCEPTED, False)


def _bad_heartbeats(world: World, rng: np.random.Generator) -> Found:
    """Nobody stands by, and heartbeats come all the same: old ones, of the future, of another arming, plan or arm."""
    accepted = in_motion(world, rng, 40)
    world.stands_by = False
    last = replace(world.answer(), plan_id=world.plan_id or "none", arming_id=world.arming_id or "none")
    far_ns = int(rng.integers(2, 1000)) * SECOND_NS
    kinds: tuple[Callable[[], dict[str, Any]], ...] = (
        lambda: vars(last),
        lambda: vars(last) | {"challenge_ns": 0, "at_ns": world.now_ns},
        lambda: {"challenge_ns": max(1, world.now_ns - far_ns)},
        lambda: {"challenge_ns": world.now_ns + far_ns},
        lambda: {"arming_id": "another"},
        lambda: {"plan_id": "another"},
        lambda: {"arm": "psm2"},
        lambda: {"pressed": False},
    )
    kind = _one(rng, kinds)
    for _ in range(110):
        world.beat(replace(world.answer(), **kind()))
        world.tick()
    return Found("bad heartbeats", accepted and world.moves, False)


def _console_fails(world: World, rng: np.random.Generator) -> Found:
    """In mid-motion the console is at fault, disabled, paused, silent, stuck, teleoperated, or has another tool."""
    accepted = in_motion(world, rng)
    word = _one(rng, ("fault", "error", "mute", "stick", "disable", "pause", "home", "tool", "teleop"))
    if word in ("disable", "pause", "home"):
        world.topics.tell_console(f"{NAME}/state_command", crtk.state_command(word, world.now_ns))
        world.console.turn(0.0)
    elif word == "tool":
        world.topics.tell_bridge(f"{NAME}/tool_type", ros_bytes(STRING, ros_message(STRING, "SCISSORS:1")))
    else:
        world.console.request(word)
    world.tick(40)
    # an arm that is stuck where it is to be shows that only when it should move on
    return Found("console fails", accepted and world.moves and word != "stick", False)


def _bad_measurements(world: World, rng: np.random.Generator) -> Found:
    """In mid-motion what is measured is not finite, too much, too little, no message, of another time, or elsewhere."""
    accepted = in_motion(world, rng, 60)
    topic = _one(rng, ("measured_js", "jaw/measured_js"))
    good = world.console.verdict()["position"]
    values = np.array(good[:6] if topic == "measured_js" else good[6:])
    for _ in range(10):
        match int(rng.integers(5)):
            case 0:
                data = crtk.joint_command(np.append(values, values), world.now_ns)
            case 1:
                data = bytearray(crtk.joint_command(values, world.now_ns))
                data[-8 * len(values) - 8 : -8] = bytes([0xFF]) * (8 * len(values))
                data = bytes(data)
            case 2:
                data = bytes(rng.integers(0, 256, int(rng.integers(0, 80)), np.uint8))
            case 3:
                data = crtk.joint_command(values, world.now_ns + int(rng.integers(-(10**12), 10**12)))
            case _:
                data = crtk.joint_command(values + rng.normal(size=len(values)), world.now_ns)
        world.topics.tell_bridge(f"{NAME}/{topic}", data)
        world.tick(int(rng.integers(1, 4)))
    return Found("bad measurements", accepted, True)


def _two_owners(world: World, rng: np.random.Generator) -> Found:
    """In mid-motion, or just before, somebody else commands the arm, stops it, or could command it."""
    late = rng.random() < 0.7
    accepted = late and in_motion(world, rng)
    topic = _one(rng, ("servo_jp", "move_jp", "servo_cp", "jaw/servo_jp", "hold", "free", "state_command", ""))
    if topic:
        world.topics.tell_bridge(f"{NAME}/{topic}", crtk.empty())
        if topic == "hold":
            world.guard.do(world.guard.monitor.hear_hold(world.now_ns))
        elif topic.endswith("servo_jp"):
            world.guard.do(world.guard.monitor.hear_stranger(world.now_ns))
    else:
        world.topics.owner_changed("somebody", True)
    # who held an arm that stood owns nothing: it may be armed anew
    was_held = topic == "hold" and not late
    if not was_held:
        world.oracle.stranger(world.now_ns * 1e-9)
    world.tick(30)
    if not late:
        accepted = set_out(world, any_plan(world, rng), 20)
    return Found("two owners", accepted and (world.moves or not late), was_held)


def _moved_before(world: World, rng: np.random.Generator) -> Found:
    """At rest the console moves the arm or says that it may; or a plan is of a frame before another plan's motion."""
    early, still_ticks = any_plan(world, rng), 2 * round(SETTLES_NS / TICK_NS)
    if rng.random() < 0.6:
        world.tick(still_ticks)
        world.console.request(_one(rng, ("drift", "teleop")))
        world.tick(4)
        return Found("moved before", set_out(world, any_plan(world, rng), 20), False)
    began = set_out(world, any_plan(world, rng), 4) and world.oracle.set_points > 0
    world.stands_by = False
    world.tick(still_ticks)
    return Found("moved before", began and set_out(world, early, 20), False)


def _odd_clock(world: World, rng: np.random.Generator) -> Found:
    """In mid-motion a turn comes late, time stands, goes back or jumps, or a recording is replayed on the rig."""
    accepted = in_motion(world, rng)
    jumps = (0, 3 * TICK_NS, 19 * TICK_NS, 100 * TICK_NS, -TICK_NS, -SECOND_NS, 3600 * SECOND_NS)
    jump_ns = _one(rng, jumps)
    if rng.random() < 0.3:
        world.step(Received(REPLAY_CLOCK, "", 0, ReplayClock(EPOCH_NS, 1.0)))
    elif world.now_ns + jump_ns > EPOCH_NS:
        world.stands_by = jump_ns in (0, 3 * TICK_NS)
        world.tick(1, jump_ns)
    world.tick(30)
    return Found("odd clock", accepted, True)


def _armed_twice(world: World, rng: np.random.Generator) -> Found:
    """In mid-motion another plan, or the same once more, is armed."""
    first, second = any_plan(world, rng), any_plan(world, rng)
    accepted = set_out(world, first, int(rng.integers(1, 60)))
    moves = world.moves
    world.publish(second)
    before = world.plan_id, world.arming_id
    answer = world.arm((first if rng.random() < 0.5 else second).plan_id)
    if moves:
        world.plan_id, world.arming_id = before
    world.tick(20)
    return Found("armed twice", bool(accepted and moves and answer and answer.outcome is Outcome.ACCEPTED), False)


def _blind(world: World, rng: np.random.Generator) -> Found:
    """In mid-motion, or just before, no frame comes any more, or each that comes is a second old."""
    before = rng.random() < 0.3
    accepted = not before and in_motion(world, rng)
    world.sees, queued = False, rng.random() < 0.5
    stale = world.stamp(world.now_ns - SECOND_NS)
    for _ in range(130):
        if queued:
            world.step(Received(FRAME_NOTICE, "", 0, FrameNotice(stale)))
        world.tick()
    if before:
        accepted = set_out(world, any_plan(world, rng), 20)
    moves, world.sees = world.moves, True
    return Found("blind", accepted and moves, False)


def _change(world: World, word: StateWord, arm: str = RIG_ARM, instance: str = "") -> bool:
    """Ask for another state; whether that was accepted."""
    header = CommandHeader(f"state-{world.now_ns}-{word.name}", world.now_ns + SECOND_NS, "ann")
    answer = world.command(CHANGE_STATE, ChangeState(header, arm, word), instance)
    return answer is None or answer.outcome is Outcome.ACCEPTED


def _state_in_motion(world: World, rng: np.random.Generator) -> Found:
    """In mid-motion somebody wants the arm enabled, homed, paused: it must go on, or stop by a hold alone."""
    in_motion(world, rng)
    moves, word = world.moves, _one(rng, WORDS)
    obeyed = _change(world, word)
    world.tick(30)
    # what stops is obeyed at any time
    stops = word in STOPPING
    return Found("state in motion", world.moves if stops else obeyed, not moves and not stops)


def _state_of_another(world: World, rng: np.random.Generator) -> Found:
    """The state of another arm, or by another's bridge."""
    named = rng.random() < 0.5
    obeyed = _change(world, _one(rng, WORDS), *(("psm2", "") if named else (RIG_ARM, "psm2")))
    world.tick(3)
    return Found("state of another", obeyed, False)


def _state_that_does_not_fit(world: World, rng: np.random.Generator) -> Found:
    """Resume of what is not paused, enable of what is enabled, or home and resume while somebody else has the arm."""
    word = _one(rng, (StateWord.RESUME, StateWord.ENABLE, StateWord.HOME))
    if word is StateWord.HOME or rng.random() < 0.3:
        world.topics.tell_bridge(f"{NAME}/move_jp", crtk.empty())
    obeyed = _change(world, word)
    world.tick(3)
    return Found("state that does not fit", obeyed, False)


def _motion_after_a_state(world: World, rng: np.random.Generator) -> Found:
    """A state is changed as it may be, and a plan armed at once: in no state but ENABLED and homed does it move."""
    obeyed = _change(world, _one(rng, WORDS))
    world.console.turn(0.0)
    accepted = set_out(world, any_plan(world, rng), int(rng.integers(2, 30)))
    return Found("motion after a state", accepted and obeyed, False)


def _other_speeds(world: World, rng: np.random.Generator) -> Found:
    """In mid-motion the ratio becomes another, again and again; what is none is refused, and nobody takes it."""
    accepted, taken = in_motion(world, rng), False
    for _ in range(int(rng.integers(1, 12))):
        ratio = float(_one(rng, (rng.uniform(0.05, 1.0), 0.0, -1.0, np.nan, np.inf, 50.0)))
        try:
            config = replace(world.bridge.config, ratio=ratio)
        except RobotBridgeError:
            continue
        taken = taken or not 0 < ratio <= 1
        world.bridge.configure(config)
        world.tick(int(rng.integers(1, 8)))
    world.bridge.configure(replace(world.bridge.config, ratio=1.0))
    return Found("other speeds", taken or accepted, not taken)


CASES: tuple[Callable[[World, np.random.Generator], Found], ...] = (
    _as_it_comes,
    _far_jumps,
    _bad_numbers,
    _bad_bytes,
    _not_now,
    _replayed_command,
    _bad_heartbeats,
    _console_fails,
    _bad_measurements,
    _two_owners,
    _moved_before,
    _odd_clock,
    _armed_twice,
    _blind,
    _state_in_motion,
    _state_of_another,
    _state_that_does_not_fit,
    _motion_after_a_state,
    _other_speeds,
)
