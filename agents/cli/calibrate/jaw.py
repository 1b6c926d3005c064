"""`suturegrasp calibrate jaw`: where an instrument's jaw closes, from an arm's states, recorded or heard."""

import threading
from collections.abc import Iterable

import numpy as np

from agents.cli.calibrate.options import Jaw
from agents.cli.places import check_new
from agents.cli.recordings.arm_states import arm_states
from agents.configuration.this_host import rig_of
from agents.launch.process import EXIT_OK, stopping
from agents.robot_bridge import jaw as bridge
from schemas.checks import MessageError
from schemas.codec import decode
from schemas.messages import RobotState
from schemas.topics import ROBOT_STATE
from shared.calibration.jaw.estimate import Estimate, JawMotion, closings_in, estimated
from shared.calibration.jaw.file import JawZero, jaw_zero_of, jaw_zero_text
from shared.calibration.stated import CalibrationError
from shared.clock import monotonic_s
from shared.kinematics.psm import LARGE_NEEDLE_DRIVER
from shared.runtime.connection import Connection, connected
from shared.runtime.taps import Tapped
from shared.terminal import UsageError, complain, say, warn

EXIT_NONE = 3
LOOKS_EVERY_S, SILENT_S = 0.5, 3.0
ENDED_S = 1.0
"""A closing is over when the jaw has not been told to close further for so long."""


def run(options: Jaw) -> int:
    """Carry it out; the exit status."""
    if options.live == (options.recording is not None):
        raise UsageError("give a recording, or --live")
    if options.output is not None:
        check_new(options.output)
    states = _heard(options) if options.recording is None else arm_states(options.recording, options.arm)
    motion, instrument = motion_of(states), instrument_of(states, options.instrument)
    try:
        found = estimated(motion)
        zero = jaw_zero_of(found, options.arm, instrument, states[-1].measured_ns)
        if refusal := bridge.Jaw.calibrated(zero).unreachable(LARGE_NEEDLE_DRIVER.jaw_limit):
            raise CalibrationError(refusal.sentence)
    except CalibrationError as error:
        return complain(str(error), EXIT_NONE)
    _tell(found, zero)
    if options.output is not None:
        options.output.write_text(jaw_zero_text(zero), encoding="utf-8")
        say(f"written to {options.output}; set jaw_file to it in the arm's section of the rig")
    return EXIT_OK


def motion_of(states: Iterable[RobotState]) -> JawMotion:
    """A jaw as it was told and measured, one sample of each time.

    Raises:
        CalibrationError: where no set point of the jaw is told.
    """
    told = {one.measured_ns: one for one in states if one.jaw_set_point_rad is not None}
    if len(told) < 2:
        silent = "no state tells where the jaw was sent: its console must publish jaw/setpoint_js (docs/dvrk.md)"
        raise CalibrationError(f"{silent}, and the robot bridge be of this version")
    ordered = [told[at_ns] for at_ns in sorted(told)]
    since_ns = ordered[0].measured_ns
    efforts = (np.nan if one.jaw_effort is None else one.jaw_effort for one in ordered)
    return JawMotion(
        np.array([(one.measured_ns - since_ns) * 1e-9 for one in ordered]),
        np.array([one.jaw_set_point_rad for one in ordered], np.float64),
        np.array([one.jaw_rad + one.jaw_zero_rad for one in ordered]),
        np.array(list(efforts), np.float64),
    )


def instrument_of(states: Iterable[RobotState], named: str) -> str:
    """Which instrument was on the arm: as its console tells, or as it was named where that does not.

    Raises:
        CalibrationError: where nobody says, they contradict each other, or it was changed.
    """
    told = sorted({one.instrument for one in states} - {""})
    if len(told) > 1:
        raise CalibrationError(
            f"the instrument was changed, from one of {' and '.join(told)} to another: do each alone"
        )
    if told and named and named != told[0]:
        raise CalibrationError(
            f"the console says that the instrument is {told[0]}, not {named}; leave --instrument out"
        )
    if not told and not named.strip():
        raise CalibrationError("the console does not tell which instrument it is; give --instrument")
    return told[0] if told else named.strip()


def _heard(options: Jaw) -> list[RobotState]:
    stopped = stopping()
    with connected(rig_of(options.config, options.host).session, None, stopped) as connection:
        say("open the jaw wide, wait a moment, and close it until it presses, slowly, by the console; Ctrl-C ends this")
        return listened(connection, options, stopped)


def listened(connection: Connection, options: Jaw, stopped: threading.Event) -> list[RobotState]:
    """The states of an arm of a rig, until its jaw was closed often enough, or stopped.

    Raises:
        CalibrationError: where none comes.
    """
    states, before, heard, since_s = list[RobotState](), 0, 0, monotonic_s()

    def take(tapped: Tapped) -> None:
        try:
            state = decode(RobotState, tapped.payload)
        except MessageError:
            return
        if state.arm == options.arm:
            states.append(state)

    with connection.listening((ROBOT_STATE,), take):
        while not stopped.wait(LOOKS_EVERY_S):
            if len(states) > heard:
                heard, since_s = len(states), monotonic_s()
            elif monotonic_s() - since_s > SILENT_S:
                raise CalibrationError(f"no state of {options.arm} comes: see that its robot bridge runs")
            if (count := _ended(states[:heard])) > before:
                before = count
                say(f"{count} of {options.closings} closings")
            if count >= options.closings:
                break
    if not states:
        raise CalibrationError(f"no state of {options.arm} came")
    return states


def _ended(states: list[RobotState]) -> int:
    """How many closings are over."""
    try:
        motion = motion_of(states)
    except CalibrationError:
        return 0
    times = motion.time_s
    return sum(times[-1] - times[closing.stop - 1] > ENDED_S for closing in closings_in(motion))


def _tell(found: Estimate, zero: JawZero) -> None:
    counted = f"{len(found.contacts)} of {found.closings} closings met resistance"
    closes = f"the jaw of {zero.arm} ({zero.instrument}) closes at {zero.closes_rad:.4f} rad as measured"
    say(f"{counted}: {closes}, when it is told {zero.told_rad:.4f} rad")
    each = ", ".join(f"{contact.closes_rad:.4f}" for contact in found.contacts)
    say(f"by closing: {each} rad; one more closes there with a deviation of {zero.deviation_rad:.4f} rad")
    squeeze_rad = bridge.Jaw.calibrated(zero).squeeze_rad
    say(f"a plan's closed jaw will be told {zero.told_rad - squeeze_rad:.4f} rad, {squeeze_rad:.4f} rad beyond it")
    if len(found.contacts) < found.closings:
        warn(f"{found.closings - len(found.contacts)} closings showed no resistance, and were left out")
