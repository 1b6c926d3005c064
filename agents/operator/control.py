"""Who controls, and whether the dead-man is pressed: what follows from what pages say, with the time passed in.

One page controls at a time, the others watch; control is taken where nobody has it, and otherwise handed over, or
passes on after ASKED_S without an answer, never while the button is pressed. Stopping is everybody's.

The button that arms is a press-and-hold. While it is down its page is sent a challenge every CHALLENGE_EVERY_S at
most and answers it. An answer counts once, and only to a challenge that was sent, so that nothing can be answered in
advance or again. After PRESS_S of answers the plan is armed. Once it is, what is passed on are the challenges of the
arm's bridge, always the newest, and each answer makes one heartbeat that echoes that very challenge: bridge and guard
judge by their own clocks how old it is, and nothing here makes it look younger. BEAT_S without an answer ends the
press, as releasing does, and so do another plan of the arm before it is armed, and a hold that anybody says. Whatever
ends it while it arms or is armed has the arm hold.
"""

import enum
import secrets
from collections.abc import Callable
from dataclasses import dataclass, field

CHALLENGE_EVERY_S = 0.04
BEAT_S = 0.18
"""Less than the bridge waits (0.2 s), so that who knows the reason tells it; a busy page may take 0.1 s to answer."""
PRESS_S = 0.6
"""A slip of the hand arms nothing."""
ASKED_S = 15.0


class Stage(enum.Enum):
    """How far a press has come."""

    PRESSING = "pressing"
    ARMING = "arming"
    ARMED = "armed"


@dataclass
class Press:
    """The button is down.

    Fields:
        alive_s: when the newest challenge was sent that was answered in time; the press began with one.
        arming_id: of the command to arm, once it is sent.
        newest: challenge of the arm's bridge that was heard, with that of the guard; zeros where none was.
        unsent: it was heard since the arm was armed, and has not been sent yet.
    """

    screen: str
    arm: str
    plan_id: str
    began_s: float
    alive_s: float
    stage: Stage = Stage.PRESSING
    arming_id: str = ""
    newest: tuple[int, int] = (0, 0)
    unsent: bool = False


@dataclass(frozen=True)
class Challenge:
    """What a page is to answer.

    Fields:
        text: what it echoes.
        sent_s: by this host's clock.
        challenge_ns, guard_challenge: of the arm's bridge and its guard; zeros for one of the desk's own.
    """

    screen: str
    text: str
    sent_s: float
    challenge_ns: int = 0
    guard_challenge: int = 0


@dataclass(frozen=True)
class ArmNow:
    """The plan is to be armed."""

    screen: str
    arm: str
    plan_id: str


@dataclass(frozen=True)
class BeatNow:
    """A heartbeat is to be published, which echoes exactly this."""

    arm: str
    plan_id: str
    arming_id: str
    challenge_ns: int
    guard_challenge: int


@dataclass(frozen=True)
class HoldNow:
    """An arm is to hold."""

    screen: str
    arm: str
    why: str


@dataclass(frozen=True)
class Noted:
    """Something to be written down and said."""

    screen: str
    what: str
    text: str


Effect = ArmNow | BeatNow | HoldNow | Noted


@dataclass
class Control:
    """The state of all pages together.

    Fields:
        screens: that are connected.
        controller, asking: of these; empty where there is none.
        press: at most one.
    """

    screens: list[str] = field(default_factory=list[str])
    controller: str = ""
    asking: str = ""
    press: Press | None = None
    new_challenge: Callable[[], str] = lambda: secrets.token_hex(8)
    _asked_s: float = 0.0
    _challenges: dict[str, Challenge] = field(default_factory=dict[str, Challenge])
    _next_s: float = 0.0

    def join(self, screen: str) -> list[Effect]:
        """A page has come; the first one controls."""
        self.screens.append(screen)
        if self.controller:
            return []
        self.controller = screen
        return [Noted(screen, "control", f"{screen} controls")]

    def leave(self, screen: str, why: str = "its connection ended") -> list[Effect]:
        """A page is gone."""
        if screen not in self.screens:
            return []
        effects = self._end(f"{screen}: {why}") if self._presses(screen) else []
        self.screens.remove(screen)
        if self.asking == screen:
            self.asking = ""
        if self.controller == screen:
            effects += self._pass_on(f"{screen} left")
        return effects

    def take(self, screen: str, now_s: float) -> list[Effect]:
        """A page asks for control."""
        if screen == self.controller:
            return []
        if not self.controller:
            self.asking = screen
            return self._pass_on("nobody controlled")
        if self.asking:
            return [Noted(screen, "refused", f"{self.asking} asks for control already")]
        self.asking, self._asked_s = screen, now_s
        return [Noted(screen, "asks", f"{screen} asks {self.controller} for control")]

    def give(self, screen: str, yes: bool) -> list[Effect]:
        """The controlling page answers, or lets go."""
        if screen != self.controller:
            return []
        if not yes:
            kept, self.asking = self.asking, ""
            return [Noted(screen, "control", f"{screen} keeps control")] if kept else []
        if self.press is not None:
            return [Noted(screen, "refused", "control is not handed over while the button is pressed")]
        return self._pass_on(f"{screen} gave it")

    def begin(self, screen: str, arm: str, plan_id: str, now_s: float) -> list[Effect]:
        """The button goes down."""
        if screen != self.controller:
            return [Noted(screen, "refused", f"{self.controller or 'nobody'} controls; ask for control first")]
        if self.press is not None:
            return [Noted(screen, "refused", "the button is pressed already")]
        self.press = Press(screen, arm, plan_id, now_s, now_s)
        self._challenges, self._next_s = {}, now_s
        return [Noted(screen, "press", f"{screen} presses to arm {arm}")]

    def challenged(self, arm: str, challenge_ns: int, guard_challenge: int) -> None:
        """Hear the newest challenge of an arm's bridge, again or for the first time."""
        press = self.press
        if press is not None and press.arm == arm and press.newest != (challenge_ns, guard_challenge):
            press.newest = challenge_ns, guard_challenge
            # a bridge at rest tells few: one of before would make the first heartbeat an old one
            press.unsent = press.stage is Stage.ARMED and challenge_ns != 0

    def challenge(self, now_s: float) -> Challenge | None:
        """What is to be sent now; None where nothing is.

        Until the arm is armed these are the desk's own, which make no heartbeat: its bridge challenges seldom.
        """
        press = self.press
        if press is None or now_s < self._next_s:
            return None
        if press.stage is not Stage.ARMED:
            made = Challenge(press.screen, self.new_challenge(), now_s)
        elif press.unsent:
            ns, guard = press.newest
            made, press.unsent = Challenge(press.screen, f"{ns}.{guard}", now_s, ns, guard), False
        else:
            return None
        self._next_s = now_s + CHALLENGE_EVERY_S
        self._challenges = {text: each for text, each in self._challenges.items() if now_s - each.sent_s <= BEAT_S}
        self._challenges[made.text] = made
        return made

    def withdraw(self, text: str) -> None:
        """A challenge has not gone out, since a newer one took its place."""
        self._challenges.pop(text, None)

    def beat(self, screen: str, text: str, now_s: float) -> list[Effect]:
        """A challenge is answered."""
        press = self.press
        if press is None or press.screen != screen:
            return []
        answered = self._challenges.pop(text, None)
        if answered is None or now_s - answered.sent_s > BEAT_S:
            return []
        press.alive_s = max(press.alive_s, answered.sent_s)
        if press.stage is Stage.PRESSING and press.alive_s - press.began_s >= PRESS_S:
            press.stage = Stage.ARMING
            return [ArmNow(screen, press.arm, press.plan_id)]
        if not answered.challenge_ns:
            return []
        return [BeatNow(press.arm, press.plan_id, press.arming_id, answered.challenge_ns, answered.guard_challenge)]

    def arming(self, plan_id: str, arming_id: str) -> bool:
        """Note the id under which a plan is being armed; False where the button is no longer down for it."""
        if self.press is None or self.press.plan_id != plan_id or self.press.stage is not Stage.ARMING:
            return False
        self.press.arming_id = arming_id
        return True

    def armed(self, screen: str, arm: str, arming_id: str, accepted: bool) -> list[Effect]:
        """The answer to arming has come; where the button is up by now, the arm holds."""
        press = self.press
        ours = press is not None and press.arming_id == arming_id
        if accepted and not ours:
            return [HoldNow(screen, arm, "the button was released while the arm was being armed")]
        if press is not None and ours:
            if accepted:
                press.stage = Stage.ARMED
            else:
                self.press = None
        return []

    def ended(self, arming_id: str) -> None:
        """What was armed has come to its end."""
        if self.press is not None and arming_id and self.press.arming_id == arming_id:
            self.press = None

    def planned(self, arm: str, plan_id: str) -> list[Effect]:
        """An arm's newest plan, which all pages show: another one than that is not armed by who looks at it."""
        press = self.press
        if press is None or press.arm != arm or press.plan_id == plan_id or press.stage is Stage.ARMED:
            return []
        return self._taken_back(press, f"{arm} has another plan by now: look at it, then press for that one")

    def held(self, arm: str, arming_id: str, why: str) -> list[Effect]:
        """An arm holds, and not because what was armed here has ended: whoever said so wants it to stand."""
        press = self.press
        if press is None or press.arm != arm or (arming_id and press.arming_id == arming_id):
            return []
        return self._taken_back(press, f"{arm} holds ({why}): look, then press again")

    def _taken_back(self, press: Press, why: str) -> list[Effect]:
        return [*self._end(why), Noted(press.screen, "refused", why)]

    def release(self, screen: str, why: str) -> list[Effect]:
        """The button goes up."""
        return self._end(f"{screen}: {why}") if self._presses(screen) else []

    def turn(self, now_s: float) -> list[Effect]:
        """What follows from time alone."""
        effects: list[Effect] = []
        if self.press is not None and now_s - self.press.alive_s > BEAT_S:
            # a press that began just now is as alive as one whose challenge was answered
            effects += self._end(self._silent(self.press, 1e3 * (now_s - self.press.alive_s)))
        if self.asking and now_s - self._asked_s > ASKED_S and self.press is None:
            effects += self._pass_on(f"{self.controller} did not answer")
        return effects

    def _silent(self, press: Press, silent_ms: float) -> str:
        if self._challenges or press.stage is not Stage.ARMED:
            return f"{press.screen} did not answer for {silent_ms:.0f} ms"
        return f"the bridge of {press.arm} told no new state for {silent_ms:.0f} ms, which is to be answered"

    def _presses(self, screen: str) -> bool:
        return self.press is not None and self.press.screen == screen

    def _end(self, why: str) -> list[Effect]:
        press, self.press, self._challenges = self.press, None, {}
        if press is None:
            return []
        noted = Noted(press.screen, "released", why)
        return [noted] if press.stage is Stage.PRESSING else [HoldNow(press.screen, press.arm, why), noted]

    def _pass_on(self, why: str) -> list[Effect]:
        """To the page that asked; to nobody where none did."""
        self.controller, self.asking = self.asking, ""
        return [Noted(self.controller, "control", f"{self.controller or 'nobody'} controls: {why}")]
