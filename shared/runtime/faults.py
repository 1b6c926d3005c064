"""What is wrong with an agent now: a step that failed is a fault until one of its kind has gone well again."""

from dataclasses import dataclass

SHOWN_S = 5.0
"""A fault is told for so long at least: health comes once a second, and people look less often."""
LIKE_PER_LINE = 100
"""After the first, only every so many like failures get a line in the log."""


@dataclass
class Faults:
    """The failures of an agent's steps.

    Fields:
        text: the fault that holds; empty where none does.
        count: how many steps failed since the agent began.
    """

    text: str = ""
    count: int = 0
    _of: str = ""
    _like: int = 0
    _failed_s: float = 0.0
    _is_well: bool = True

    def failed(self, of: str, text: str, now_s: float, alone: bool = False) -> bool:
        """Note that a step failed, and what it was a step of; whether that is to be logged.

        `alone`: nothing of its kind need follow, as of a command, so that the fault holds no longer than it is shown.
        """
        self.count += 1
        self._like = self._like + 1 if text == self.text else 0
        self._of, self.text, self._failed_s, self._is_well = of, text, now_s, alone
        return self._like % LIKE_PER_LINE == 0

    def went_well(self, of: str) -> None:
        """Note that a step of that kind went well."""
        self._is_well = self._is_well or of == self._of

    def ended(self, now_s: float) -> bool:
        """Whether the fault holds no longer; true once."""
        over = bool(self.text) and self._is_well and now_s - self._failed_s > SHOWN_S
        if over:
            self.text = ""
        return over
