"""What whoever sits before a replay may do: hold it, let it go on, step to the next frame, end it."""

import threading


class Controls:
    """Shared between the thread that plays and those that listen to people and signals."""

    def __init__(self, held: bool = False) -> None:
        self._condition = threading.Condition()
        self._held, self._steps = held, 0
        self._stopped = self._leaving = False

    def toggle(self) -> None:
        """Hold, or go on."""
        with self._condition:
            self._held, self._steps = not (self._held and self._steps == 0), 0
            self._condition.notify_all()

    def step(self) -> None:
        """Go on until one more frame has been sent, then hold."""
        with self._condition:
            self._held = True
            self._steps += 1
            self._condition.notify_all()

    def stop(self) -> None:
        """End the replay."""
        with self._condition:
            self._stopped = True
            self._condition.notify_all()

    def stop_when_done(self) -> None:
        """End the replay after the steps that are still to be done."""
        with self._condition:
            self._leaving = True
            self._stopped = self._stopped or self._steps == 0
            self._condition.notify_all()

    def step_done(self) -> None:
        """A frame was sent: one step is done."""
        with self._condition:
            self._steps = max(0, self._steps - 1)
            self._stopped = self._stopped or (self._leaving and self._steps == 0)

    @property
    def stopped(self) -> bool:
        """Whether the replay is to end."""
        return self._stopped

    @property
    def held(self) -> bool:
        """Whether nothing is to be sent now."""
        return self._held and self._steps == 0

    def wait(self, seconds: float | None) -> None:
        """Until somebody does something, or so many seconds have passed."""
        with self._condition:
            if not self._stopped:
                self._condition.wait(seconds)
