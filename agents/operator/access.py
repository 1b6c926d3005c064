"""Who may use the page: addresses that it is served at, links that work once, and secrets that follow each other.

Nothing here is kept in a cookie, so that no other site's page can have a browser send it along. A page is named a
link's token in the part of the address that browsers send to nobody; it exchanges it for a secret, and each use of a
secret ends it and gives the next. What was overheard, or is played again, opens nothing.
"""

import hmac
import secrets
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

TOKEN_BYTES = 24
MOST_SESSIONS = 32
"""Screens that may be let in during one run; the one that was away longest is forgotten for a new one."""
ORIGIN, HOST, SITE = "Origin", "Host", "Sec-Fetch-Site"


def _new_token() -> str:
    return secrets.token_urlsafe(TOKEN_BYTES)


@dataclass(frozen=True)
class Addresses:
    """Where the page is served.

    Fields:
        hosts: host and port as a browser writes them.
    """

    scheme: str
    hosts: tuple[str, ...]

    def is_ours(self, headers: Mapping[str, str]) -> bool:
        """Whether a request names one of these, and not a name that somebody had resolve to this machine."""
        return headers.get(HOST, "").lower() in self.hosts

    def is_from_us(self, headers: Mapping[str, str]) -> bool:
        """Whether a request comes from the page itself: browsers let no other page write this header."""
        origins = [f"{self.scheme}://{host}" for host in self.hosts]
        site = headers.get(SITE, "same-origin")
        return self.is_ours(headers) and headers.get(ORIGIN, "") in origins and site == "same-origin"


@dataclass
class Access:
    """Links and secrets.

    Fields:
        link: the token of the link that works now.
        changed: told of each new link.
    """

    changed: Callable[[str], None] = lambda _link: None
    link: str = field(default_factory=_new_token)
    _secrets: dict[str, str] = field(default_factory=dict[str, str])
    _count: int = 0

    def exchange(self, token: str) -> str | None:
        """The first secret of a new session; None for a token that is not the link's. The next link is another one."""
        if not hmac.compare_digest(_bytes(token), _bytes(self.link)):
            return None
        self.link = _new_token()
        self._count += 1
        while len(self._secrets) >= MOST_SESSIONS:
            del self._secrets[next(iter(self._secrets))]
        secret = self._secrets[f"screen {self._count}"] = _new_token()
        self.changed(self.link)
        return secret

    def enter(self, secret: str) -> tuple[str, str] | None:
        """The session that a secret belongs to, and its next secret; None where it is none, or was used."""
        names = [name for name, known in self._secrets.items() if hmac.compare_digest(_bytes(secret), _bytes(known))]
        if not names:
            return None
        # at the end, among those that were used last
        del self._secrets[names[0]]
        self._secrets[names[0]] = _new_token()
        return names[0], self._secrets[names[0]]


def _bytes(text: str) -> bytes:
    # JSON can hold halves of characters
    return text.encode(errors="replace")
