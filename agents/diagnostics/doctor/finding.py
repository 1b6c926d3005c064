"""One thing that `suturegrasp doctor` looked at."""

from dataclasses import dataclass

UNKNOWN = "unknown"


@dataclass(frozen=True)
class Finding:
    """What was looked at and found; `remedy` is empty where it is well.

    What cannot be told begins with `unknown`, with the reason: it is neither well nor wrong.
    """

    what: str
    found: str
    remedy: str = ""

    @property
    def state(self) -> str:
        """How it is, as it is printed."""
        if self.remedy:
            return "WRONG"
        return "?" if self.found.startswith(UNKNOWN) else "ok"
