"""How the config of an agent says which of its fields may be set while the agent runs, and to what."""

import json
from dataclasses import dataclass, field
from typing import Any, Protocol

ALLOWED = "allowed"
"""Where the metadata of a field says so."""


class Allowed(Protocol):
    """What a field may be set to; `configured` is what the agent was started with."""

    def holds(self, value: Any, configured: Any, /) -> bool:
        """Whether a value is allowed."""
        ...

    def text(self, configured: Any, /) -> str:
        """What is allowed, as a clause after "it may be"."""
        ...


@dataclass(frozen=True)
class Between:
    """Numbers from `least` to `most`, whole ones where `least` is whole; without `most`, up to what was configured."""

    least: float
    most: float | None = None

    def holds(self, value: Any, configured: Any, /) -> bool:
        """Whether the value is a number of that kind in the range; what is no number lies in none."""
        kinds = int if isinstance(self.least, int) else (int, float)
        if isinstance(value, bool) or not isinstance(value, kinds):
            return False
        return self.least <= value <= self._most(configured)

    def text(self, configured: Any, /) -> str:
        """The range in words."""
        kind = "a whole number" if isinstance(self.least, int) else "a number"
        ends = " (as configured)" if self.most is None else ""
        return f"{kind} from {self.least:g} to {self._most(configured):g}{ends}"

    def _most(self, configured: Any) -> float:
        return configured if self.most is None else self.most


@dataclass(frozen=True)
class OneOf:
    """One of a few values."""

    values: tuple[Any, ...]

    def holds(self, value: Any, _configured: Any, /) -> bool:
        """Whether the value is one of them, and of the same type."""
        return any(type(value) is type(known) and value == known for known in self.values)

    def text(self, _configured: Any, /) -> str:
        """The values in words."""
        return "one of " + ", ".join(json.dumps(value) for value in self.values)


def settable(default: Any, allowed: Allowed) -> Any:
    """A field of a config that may be set while its agent runs."""
    return field(default=default, metadata={ALLOWED: allowed})
