"""Everything that is made to fail, one at a time, in the middle of a grasp."""

from collections.abc import Callable, Generator
from contextlib import AbstractContextManager, ExitStack, contextmanager
from dataclasses import dataclass

from tests.rigs.faults.lab import Lab
from tests.rigs.faults.rig import HOSTS, KINDS, ROUTER, RUNS
from tests.rigs.faults.slow_cable import delayed, losing

AWAY_S = 0.5
"""How long what was killed is away before it is started again, as `up` starts it."""
CUT_S, LOSSY_S, NARROW_S, STOPPED_S, FULL_S, JUMPED_S = 3.0, 6.0, 6.0, 3.0, 4.0, 6.0
LOSS_PERCENT, DELAY_S, MEGABITS = 5, 0.04, 10
JUMPS_S = (10.0, -10.0)
LATE = "on the way|ms ago|no heartbeat"
LAB_HOSTS = tuple(host for host in HOSTS if host != ROUTER)
AGENTS = tuple(name for host in LAB_HOSTS for name in RUNS[host])
STOPPED = ("perception", "reconstruction", "planner", "record", "simulator")


@dataclass(frozen=True)
class Fault:
    """Something that fails, and comes right again.

    Fields:
        during: what makes it fail, for as long as it lasts.
        lasts_s: for how long.
        holds: whether the arm's inputs die of it, so that it must hold.
        restarts: what is started anew in the end; recovery counts from when that is ready.
        named: pattern of a sentence that names it.
        of_recorder: whether recording must go on again too.
        wants_clocks: whether it needs hosts whose clocks can be set.
    """

    name: str
    during: Callable[[Lab], AbstractContextManager[None]]
    lasts_s: float
    named: str
    holds: bool = False
    restarts: str = ""
    of_recorder: bool = False
    wants_clocks: bool = False


def all_faults() -> list[Fault]:
    """All of them, those that need clocks last."""
    return [
        *(killed(name) for name in AGENTS),
        killed("arm", restarts=False),
        killed(ROUTER),
        *(cut_off(host) for host in LAB_HOSTS),
        lossy(),
        narrow(),
        *(standing_still(name) for name in STOPPED),
        full_disk(),
        *(jumped(host, seconds) for host in LAB_HOSTS for seconds in JUMPS_S),
    ]


def killed(name: str, restarts: bool = True) -> Fault:
    """SIGKILL to a process, which is started again a moment later."""

    @contextmanager
    def during(lab: Lab) -> Generator[None]:
        lab.processes.kill(name)
        yield
        if restarts:
            lab.start(name)

    kind = KINDS.get(name, name)
    named = {ROUTER: "the link to the router", "arm": "no heartbeat"}.get(name, rf"^{kind}( \w+)?: (gone|was started)")
    holds = name in (ROUTER, "arm")
    of_recorder = name == "record"
    return Fault(f"kill -9 {name}", during, AWAY_S, named, holds, name if restarts else "", of_recorder)


def cut_off(host: str) -> Fault:
    """Nothing reaches a host for a while."""
    kinds = "|".join(KINDS.get(name, name) for name in RUNS[host])
    named = rf"^({kinds})( \w+)?: (silent|gone|the link)"
    what, holds = f"{host} cut off for {CUT_S:g} s", host in ("robot", "desk")
    return Fault(what, lambda lab: lab.network.cut_off(host), CUT_S, named, holds, of_recorder=host == "desk")


def lossy() -> Fault:
    """All four hosts lose packets, and what arrives is late."""

    @contextmanager
    def during(lab: Lab) -> Generator[None]:
        with ExitStack() as stack:
            stack.enter_context(delayed(lab.network, DELAY_S, LAB_HOSTS))
            stack.enter_context(losing(lab.network, LOSS_PERCENT, LAB_HOSTS))
            yield

    name = f"{LOSS_PERCENT} % loss, {1e3 * DELAY_S:.0f} ms delay"
    return Fault(name, during, LOSSY_S, LATE)


def narrow() -> Fault:
    """The links of all four hosts carry little."""
    return Fault(f"{MEGABITS} Mbit/s links", lambda lab: lab.network.narrowed(MEGABITS, LAB_HOSTS), NARROW_S, LATE)


def standing_still(name: str) -> Fault:
    """A process takes nothing off its link, which stays open."""
    named = rf"^{KINDS.get(name, name)}( \w+)?: (silent|gone|hanging|the link)"
    return Fault(f"SIGSTOP {name}", lambda lab: lab.processes.stopped(name), STOPPED_S, named)


def full_disk() -> Fault:
    """The recorder's disk has no room, until somebody makes some."""
    named = r"^recorder( \w+)?: .*(free|cannot be written)"
    return Fault("the recorder's disk is full", lambda lab: lab.disk.full(), FULL_S, named, of_recorder=True)


def jumped(host: str, seconds: float) -> Fault:
    """A host's clock is off for a while."""

    @contextmanager
    def during(lab: Lab) -> Generator[None]:
        lab.processes.set_clock(host, seconds)
        yield
        lab.processes.set_clock(host, 0.0)

    holds = host in ("robot", "desk")
    return Fault(f"clock of {host} {seconds:+g} s", during, JUMPED_S, "clock", holds, wants_clocks=True)
