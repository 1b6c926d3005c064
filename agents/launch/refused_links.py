"""Links that this process's router refused, counted.

Zenoh tells its own log alone of them, on standard output: a line for each link without a certificate of the lab. Access
rules deny in silence, by design of Zenoh, and count nothing.
"""

import os
import re
import sys
import threading
from collections import Counter
from collections.abc import Callable

from shared.runtime.session import have_links_logged

REFUSED = re.compile(r"WARN .*zenoh_link_tls\S*: (?P<reason>.*?)\.?(?: Hint: .*)?$")
DETAILS = re.compile(r": verification time .*")
"""Of a certificate that is out of date: seconds, which would make every refusal a reason of its own."""
STYLE = re.compile(r"\x1b\[[0-9;]*m")
LIKE_PER_LINE = 100
"""After the first, only every so many like refusals are told."""
STANDARD_OUTPUT = 1


class RefusedLinks:
    """Reads this process's own standard output, passes on what is something else, and tells of refused links.

    Fields:
        counted: links refused so far, by reason.
    """

    def __init__(self, tell: Callable[[str], None]) -> None:
        self.counted: Counter[str] = Counter()
        self._tell = tell
        self._real = os.dup(STANDARD_OUTPUT)
        reading, writing = os.pipe()
        os.dup2(writing, STANDARD_OUTPUT)
        os.close(writing)
        self._thread = threading.Thread(target=self._read, args=(reading,), name="refused links", daemon=True)
        self._thread.start()
        have_links_logged()

    def close(self) -> None:
        """Give standard output back; what was said before is still counted."""
        sys.stdout.flush()
        os.dup2(self._real, STANDARD_OUTPUT)
        self._thread.join(1.0)

    def _read(self, reading: int) -> None:
        with os.fdopen(reading, "rb") as lines:
            for line in lines:
                if not self._count(line.decode(errors="replace")):
                    os.write(self._real, line)

    def _count(self, line: str) -> bool:
        found = REFUSED.search(STYLE.sub("", line).rstrip())
        if found is None:
            return False
        reason = DETAILS.sub("", found["reason"])
        self.counted[reason] += 1
        if self.counted[reason] % LIKE_PER_LINE == 1:
            self._tell(f"a link was refused: {reason} ({self.counted[reason]} so far)")
        return True
