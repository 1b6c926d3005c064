"""A row of the table: what one attack came to."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Row:
    """What became of what was sent.

    Fields:
        delivered: reached somebody; of malformed messages, those that are valid for all that anybody can tell.
        refused: counted as such by whoever refused it; None where nobody counts, as with access rules.
        dropped: newer ones took their place before anybody looked.
        missed: sequence numbers that never arrived.
        crashed: processes that ended.
        barred: whether nothing may be delivered at all.
    """

    attack: str
    sent: int
    delivered: int
    refused: int | None = None
    dropped: int | None = None
    missed: int | None = None
    crashed: int = 0
    barred: bool = False

    @property
    def unaccounted(self) -> int | None:
        """Messages of which nobody tells; None where access rules deny in silence."""
        if self.refused is None:
            return None
        return self.sent - self.delivered - self.refused - (self.dropped or 0) - (self.missed or 0)

    @property
    def good(self) -> bool:
        """Whether it came to nothing."""
        return not self.crashed and not self.unaccounted and not (self.barred and self.delivered)
