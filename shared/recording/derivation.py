"""What a recording was made of, where it is not a recorder's own: a note for each derivation, the newest last.

A derived file keeps the notes of its source, which tell how the session was run. What is otherwise in it stands here.
"""

import hashlib
import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import schemas
from schemas.migrations import lifted_agent, lifted_key
from shared.recording.entry import Note

DERIVED, BEGUN = "derived", "derivation begun"
"""The second lies at the file's beginning, with what is known there, for a file that is cut off before the first."""
CUT = "cut"
"""What files that version 0.2 or an older one cut have in place of it."""
UNUSED_FRAMES = "frames of which nothing was made"
"""As files have it; what was made of some may lie outside of a stretch, so it is told of what is in the file."""
BEFORE_AND_AFTER = "messages before and after"
MADE_NO_MORE = "recorded outputs that are made no more"
UNKNOWN_TOPICS = "messages of topics that this version does not know"
WORDS = ("how", "source", "sha256", "source_said", "version", "read_as")
READ_BYTES = 1 << 22


@dataclass(frozen=True)
class Anew:
    """An agent that ran anew.

    Fields:
        keys: whose messages in this file are its outputs.
        outputs: how many of them are.
        kept: its outputs that could not be repeated, and are as of the source; kept_ns: when each was received.
        step_ms_p50, step_ms_p99: how long its steps took now; None without any.
    """

    keys: tuple[str, ...]
    outputs: int
    kept: int
    step_ms_p50: float | None
    step_ms_p99: float | None
    kept_ns: tuple[int, ...] = ()


@dataclass(frozen=True)
class Derivation:
    """How a recording came from another.

    Fields:
        how: in words, such as `cut from 2.0 s to 5.0 s` or `replayed through perception`.
        source, sha256: name and digest of the file that it was made of; the digest is empty where nobody noted it.
        source_said: whether that file is complete, in its own words.
        version: of the program that made it.
        agents: that ran anew, by name; all other outputs are as of the source.
        settings: of these agents, as they were in the source and as they are in force: `ours -> paper`, by key.
        left_out: on purpose, how many messages by what they are.
        read_as: the older version that messages were read as, and rewritten from; empty where it is the same.
        from_ns: where agents ran anew, when the first message of what they ran on was published; 0 where that is not
            known.
    """

    how: str
    source: str
    sha256: str = ""
    source_said: str = ""
    version: str = schemas.__version__
    agents: dict[str, Anew] = field(default_factory=dict[str, Anew])
    settings: dict[str, str] = field(default_factory=dict[str, str])
    left_out: dict[str, int] = field(default_factory=dict[str, int])
    read_as: str = ""
    from_ns: int = 0

    @property
    def note(self) -> Note:
        """The note that tells of it."""
        told = {name: value for name, value in asdict(self).items() if value}
        return Note(DERIVED, {name: v if isinstance(v, str) else json.dumps(v) for name, v in told.items()})

    @property
    def sentence(self) -> str:
        """The same in one line."""
        digest = f" (sha256 {self.sha256[:12]})" if self.sha256 else ""
        parts = [f"derived: {self.how}, of {self.source}{digest}"]
        heard = [name for name, one in self.agents.items() if one.outputs or one.kept]
        if heard:
            parts.append(f"ran anew, in {self.version}: {', '.join(heard)}; what other agents said is as of the source")
        if silent := [name for name in self.agents if name not in heard]:
            parts.append(f"nothing in it is of {', '.join(silent)}, which ran anew{' too' if heard else ''}")
        parts += [
            f"{one.kept} {'output' if one.kept == 1 else 'outputs'} of {name} as of the source too"
            for name, one in self.agents.items()
            if one.kept
        ]
        if self.settings:
            parts.append("settings: " + ", ".join(f"{key} {change}" for key, change in self.settings.items()))
        if self.left_out:
            parts.append(
                # a file that was cut off has not come to say how many
                "left out on purpose: "
                + ", ".join(
                    f"{count or 'some'} {'frames of which nothing in it was made' if what == UNUSED_FRAMES else what}"
                    for what, count in self.left_out.items()
                )
            )
        if self.read_as:
            parts.append(f"its messages were those of version {self.read_as}")
        return "; ".join(parts)


def as_far_as_held(note: Note, held: Mapping[str, Sequence[int]]) -> Note:
    """The note of a derivation as a file has it that holds these messages, by key when each was received."""
    told = _read(note)
    if told is None or not told.agents:
        return note
    agents = {name: _as_far_as_held(anew, held) for name, anew in told.agents.items()}
    return Note(note.name, note.facts | {"agents": json.dumps({name: asdict(one) for name, one in agents.items()})})


def _as_far_as_held(anew: Anew, held: Mapping[str, Sequence[int]]) -> Anew:
    received_ns = [at_ns for key in anew.keys for at_ns in held.get(key, ())]
    kept_ns = tuple(sorted(set(anew.kept_ns) & set(received_ns)))
    keys = tuple(key for key in anew.keys if held.get(key))
    return replace(anew, keys=keys, outputs=len(received_ns) - len(kept_ns), kept=len(kept_ns), kept_ns=kept_ns)


def digest_of(path: Path) -> str:
    """The SHA-256 digest of a file, in hexadecimal digits.

    Raises:
        OSError: where it cannot be read.
    """
    digest = hashlib.sha256()
    with path.open("rb") as file:
        while piece := file.read(READ_BYTES):
            digest.update(piece)
    return digest.hexdigest()


def derivations(notes: Iterable[Note]) -> tuple[Derivation, ...]:
    """What the notes of a recording tell of how it was made, the newest last; none of a recorder's own file."""
    told = list(notes)
    found = (_read(note) for note in (*(note for note in told if note.name != BEGUN), *unfinished_of(told)))
    return tuple(one for one in found if one is not None)


def unfinished_of(notes: Iterable[Note]) -> list[Note]:
    """The notes of derivations that were begun, and cut off before they were told whole; the newest last.

    A file says at its very beginning what it is made of, before it repeats what its source said, at first in short.
    """
    told = list(notes)
    finished = {_source(note) for note in told if note.name == DERIVED}
    begun = {_source(note): note for note in told if note.name == BEGUN and _source(note) not in finished}
    return list(reversed(begun.values()))


def _source(note: Note) -> tuple[str, str]:
    return note.facts.get("source", ""), note.facts.get("sha256", "")


def _read(note: Note) -> Derivation | None:
    facts = note.facts
    if note.name == CUT:
        unused = facts.get("unused_frames", "0")
        left_out = {UNUSED_FRAMES: int(unused)} if unused.isdecimal() and int(unused) else {}
        return Derivation("cut", facts.get("of", "a file"), version="", left_out=left_out)
    if note.name not in (DERIVED, BEGUN):
        return None
    how, source, sha256, said, version, read_as = (facts.get(name, "") for name in WORDS)
    began = facts.get("from_ns", "")
    from_ns = int(began) if began.isdecimal() else 0
    told = Derivation(how, source, sha256, said, version, read_as=read_as, from_ns=from_ns)
    try:
        agents = {lifted_agent(name): _anew(one) for name, one in _table(facts, "agents").items()}
        return replace(told, agents=agents, settings=_table(facts, "settings"), left_out=_table(facts, "left_out"))
    except (ValueError, TypeError, AttributeError, LookupError):
        # of a later version, or spoilt: that it was derived is true all the same
        return told


def _anew(facts: dict[str, Any]) -> Anew:
    known: dict[str, Any] = facts | {
        "keys": tuple(lifted_key(key) for key in facts.get("keys", ())),
        "kept_ns": tuple(facts.get("kept_ns", ())),
    }
    return Anew(**known)


def _table(facts: dict[str, str], name: str) -> dict[str, Any]:
    return json.loads(facts.get(name, "{}"))
