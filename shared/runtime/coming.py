"""What an agent's steps gave that is still worked on; it is published under the list of what its step was made from."""

from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass

from schemas.messages import Consumed
from shared.clock import monotonic_s
from shared.runtime.agent import Later
from shared.runtime.progress import Handled


@dataclass(frozen=True)
class Expected:
    """An output that is worked on.

    Fields:
        fed: what its step was made from.
        of: what its step was fed, as faults name it.
        began_s: when that began, on the monotonic clock.
    """

    later: Later
    fed: tuple[Consumed, ...]
    of: str
    began_s: float

    def took_ms(self) -> float:
        """How long ago its step began."""
        return 1e3 * (monotonic_s() - self.began_s)


class Coming:
    """Outputs in their order, and the messages that are not done with before they are published; for one thread."""

    def __init__(self, handled: Handled, wake: Callable[[], None]) -> None:
        """`wake` is called, from any thread, when one is there."""
        self._handled, self._wake = handled, wake
        self._expected: deque[Expected] = deque()
        self._done_then: list[Consumed] = []

    def add(self, later: Later, fed: tuple[Consumed, ...], of: str, step_ms: float) -> None:
        """Expect an output of a step that has taken so long until now."""
        self._expected.append(Expected(later, fed, of, monotonic_s() - 1e-3 * step_ms))
        later.coming.add_done_callback(lambda _: self._wake())

    def note(self, key: str, epoch: int, sequence: int) -> None:
        """A message is done with, as soon as all has been published that followed from it and from those before it."""
        self._done_then.append(Consumed(key, epoch, sequence))
        self._note_done()

    def there(self, wait: bool) -> Iterator[Expected]:
        """Each output that can be published now; all of them, where its user will wait for those that are worked on."""
        while self._expected and (wait or self._expected[0].later.coming.done()):
            yield self._expected[0]
            self._expected.popleft()
            self._note_done()

    def _note_done(self) -> None:
        if not self._expected:
            for done in self._done_then:
                self._handled.note(done.key, done.epoch, done.sequence)
            self._done_then.clear()
