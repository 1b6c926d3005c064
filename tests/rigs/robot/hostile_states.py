"""Commands for an arm's state, and other speeds, where they must not be obeyed, or just before and after a motion."""

from dataclasses import replace

import numpy as np

from agents.robot_bridge.config import RobotBridgeError
from schemas.messages import ChangeState, CommandHeader, Outcome, StateWord
from schemas.topics import CHANGE_STATE
from shared.ros import crtk
from tests.rigs.robot.hostile_found import Found
from tests.rigs.robot.hostile_plans import any_plan, set_out
from tests.rigs.robot.world import NAME, RIG_ARM, SECOND_NS, World

WORDS = tuple(StateWord)
STOPPING = (StateWord.PAUSE, StateWord.DISABLE)


def change(world: World, word: StateWord, arm: str = RIG_ARM, instance: str = "") -> bool:
    """Ask for another state; whether that was accepted."""
    header = CommandHeader(f"state-{world.now_ns}-{word.name}", world.now_ns + SECOND_NS, "ann")
    answer = world.command(CHANGE_STATE, ChangeState(header, arm, word), instance)
    return answer is None or answer.outcome is Outcome.ACCEPTED


def state_in_motion(world: World, rng: np.random.Generator) -> Found:
    """In mid-motion somebody wants the arm enabled, homed, paused: it must go on, or stop by a hold alone."""
    set_out(world, any_plan(world, rng), int(rng.integers(1, 80)))
    moves, word = world.moves, WORDS[rng.integers(len(WORDS))]
    obeyed = change(world, word)
    world.tick(30)
    # what stops is obeyed at any time
    return Found("state in motion", obeyed if word not in STOPPING else world.moves, not moves and word not in STOPPING)


def state_of_another(world: World, rng: np.random.Generator) -> Found:
    """The state of another arm, or by another's bridge."""
    named = rng.random() < 0.5
    obeyed = change(world, WORDS[rng.integers(len(WORDS))], *(("psm2", "") if named else (RIG_ARM, "psm2")))
    world.tick(3)
    return Found("state of another", obeyed, False)


def state_that_does_not_fit(world: World, rng: np.random.Generator) -> Found:
    """Resume of what is not paused, enable of what is enabled, or home and resume while somebody else has the arm."""
    word = (StateWord.RESUME, StateWord.ENABLE, StateWord.HOME)[rng.integers(3)]
    if word is StateWord.HOME or rng.random() < 0.3:
        world.topics.tell_bridge(f"{NAME}/move_jp", crtk.empty())
    obeyed = change(world, word)
    world.tick(3)
    return Found("state that does not fit", obeyed, False)


def motion_after_a_state(world: World, rng: np.random.Generator) -> Found:
    """A state is changed as it may be, and a plan armed at once: in no state but ENABLED and homed does it move."""
    word = WORDS[rng.integers(len(WORDS))]
    obeyed = change(world, word)
    world.console.turn(0.0)
    accepted = set_out(world, any_plan(world, rng), int(rng.integers(2, 30)))
    return Found("motion after a state", accepted and obeyed, False)


def other_speeds(world: World, rng: np.random.Generator) -> Found:
    """In mid-motion the ratio becomes another, again and again; what is none is refused, and nobody takes it."""
    accepted = set_out(world, any_plan(world, rng), int(rng.integers(1, 80)))
    taken = False
    for _ in range(int(rng.integers(1, 12))):
        ratio = float((rng.uniform(0.05, 1.0), 0.0, -1.0, np.nan, np.inf, 50.0)[rng.integers(6)])
        try:
            config = replace(world.bridge.config, ratio=ratio)
        except RobotBridgeError:
            continue
        taken = taken or not 0 < ratio <= 1
        world.bridge.configure(config)
        world.tick(int(rng.integers(1, 8)))
    world.bridge.configure(replace(world.bridge.config, ratio=1.0))
    return Found("other speeds", taken if taken else accepted, not taken)


STATE_CASES = (state_in_motion, state_of_another, state_that_does_not_fit, motion_after_a_state, other_speeds)
