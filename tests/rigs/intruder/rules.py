"""What another agent's certificate is good for: perception's, used for everything that is not perception's own."""

import threading
from typing import Any

import zenoh

from schemas.codec import decode, encode, encoding_name
from schemas.messages import CommandAnswer, Outcome
from schemas.topics import ANY_AGENT, MAIN, REPLAY_CLOCK, SET, TOPICS, Delivery, Topic, key
from shared.clock import now_ns
from shared.runtime.attachment import Attachment, pack
from shared.runtime.commands import send_command
from shared.runtime.delivery import declare_publisher, subscribe
from tests.rigs.intruder.malformed import valid_messages
from tests.rigs.intruder.rig import ARM, OPERATOR, Rig, owned_topics
from tests.rigs.intruder.rows import Row

INTRUDER = "perception"
EPOCH = 0xBAD
EACH = 20
NEVER_AFTER_S, ASKED_S = 0.5, 0.3
QUESTIONS = ("clock", "progress", "facts", "link")


def forged(rig: Rig) -> list[Row]:
    """Puts, deletes, histories, answers, presence and commands; none of it may reach anybody."""
    session = rig.session(f"{INTRUDER}.main")
    keys = [(key(rig.config.rig, t, _instance(t, kind), kind), t) for t, kind in owned_topics() if kind != INTRUDER]
    keys.append((key(rig.config.rig, REPLAY_CLOCK), REPLAY_CLOCK))
    return [*_published(rig, session, keys), _told_late(rig, session, keys), *_answered(rig, session)]


def commands_of_rig(rig: Rig) -> list[tuple[Topic, str, str]]:
    """Each command with its key and who receives it."""
    kinds = ("planner", "perception", "robot_bridge", "camera", "reconstruction", "simulator")
    found: list[tuple[Topic, str, str]] = []
    for topic in TOPICS:
        if topic.delivery is not Delivery.COMMAND:
            continue
        receivers = kinds if topic.receiver == ANY_AGENT else (topic.receiver,)
        for kind in receivers:
            agent = kind if topic.agent == ANY_AGENT else ""
            instance = ARM if topic.per_arm or (topic is SET and kind == "robot_bridge") else MAIN
            found.append((topic, key(rig.config.rig, topic, instance, agent), kind))
    return found


def _instance(topic: Topic, kind: str) -> str:
    return ARM if topic.per_arm or kind == "robot_bridge" else MAIN


def _published(rig: Rig, session: zenoh.Session, keys: list[tuple[str, Topic]]) -> list[Row]:
    """Valid messages and deletes on the keys of all others."""
    valid, sent = valid_messages(ARM), 0
    for name, topic in keys:
        publisher = declare_publisher(session, name, topic, waits=True)
        for sequence in range(EACH):
            publisher.put(valid[topic](), attachment=pack(Attachment(EPOCH, sequence, now_ns(), 0.0)))
            session.put(name, valid[topic](), attachment=pack(Attachment(EPOCH, sequence, now_ns(), 0.0)))
            session.delete(name)
            sent += 2
        publisher.undeclare()
    # with a wildcard, which would name the keys of others among its own
    wide = f"suturegrasp/{rig.config.rig}/*/*/*"
    for sequence in range(EACH):
        session.put(wide, b"x", attachment=pack(Attachment(EPOCH, sequence, now_ns(), 0.0)))
    threading.Event().wait(NEVER_AFTER_S)
    heard = sum(n for (_, run), n in list(rig.heard.counts.items()) if run == EPOCH)
    unnumbered = sum(n for (_, run), n in list(rig.heard.counts.items()) if run is None)
    return [
        Row("another's topics: puts", sent + EACH, heard, crashed=len(rig.ended()), barred=True),
        Row("another's topics: deletes", sent // 2, unnumbered, crashed=len(rig.ended()), barred=True),
    ]


def _told_late(rig: Rig, session: zenoh.Session, keys: list[tuple[str, Topic]]) -> Row:
    """What whoever comes late is told of states and events: by their owners alone."""
    told, sent = [0], 0
    publishers: list[Any] = []
    for name, topic in keys:
        if topic.delivery in (Delivery.STATE, Delivery.EVENT):
            publishers.append(declare_publisher(session, name, topic))
            publishers[-1].put(b"forged", attachment=pack(Attachment(EPOCH, 0, now_ns(), 0.0)))
            sent += 1

    def hear(sample: zenoh.Sample) -> None:
        told[0] += sample.payload.to_bytes() == b"forged"

    late: list[Any] = []
    for name, topic in keys:
        if topic.delivery in (Delivery.STATE, Delivery.EVENT):
            late.append(subscribe(rig.session(f"{OPERATOR}.desk"), name, topic, hear, lambda _: None))
    threading.Event().wait(NEVER_AFTER_S)
    for declared in (*late, *publishers):
        declared.undeclare()
    return Row("another's history", sent, told[0], barred=True)


def _answered(rig: Rig, session: zenoh.Session) -> list[Row]:
    """Commands that it gives and those that it would answer, questions that it would answer, and presence."""
    valid, asked, answers, given = valid_messages(ARM), 0, 0, 0
    reached: list[str] = []
    for topic, name, kind in commands_of_rig(rig):
        if kind == INTRUDER:
            # what it would ask itself would never leave its process
            continue
        asked += 1
        encoding = encoding_name(topic.message)
        answers += sum(1 for _ in session.get(name, payload=valid[topic](), encoding=encoding, timeout=ASKED_S))
    kept: list[Any] = []

    def answer(query: zenoh.Query) -> None:
        reached.append(str(query.key_expr))
        query.reply(query.key_expr, encode(CommandAnswer("x", Outcome.ACCEPTED, "", "")))
        query.drop()

    others = [(t, name, kind) for t, name, kind in commands_of_rig(rig) if kind != INTRUDER]
    for _, name, _ in others:
        kept.append(session.declare_queryable(name, answer, complete=True))
    for kind in ("camera", "planner", "simulator", "robot_bridge"):
        kept += [session.declare_queryable(f"{rig.root(kind)}/{q}", answer, complete=True) for q in QUESTIONS]
        kept.append(session.liveliness().declare_token(rig.root(kind)))
    operator = rig.session(f"{OPERATOR}.desk")
    # the bridge and the simulator are not there yet: whoever answers for them is the intruder
    for topic, _, kind in others:
        if kind in ("robot_bridge", "simulator"):
            given += 1
            message = decode(topic.message, valid[topic]())
            agent = kind if topic.agent == ANY_AGENT else ""
            instance = ARM if kind == "robot_bridge" else MAIN
            told = send_command(operator, rig.config.rig, topic, message, instance, timeout_s=ASKED_S, agent=agent)
            if told.outcome is not Outcome.UNKNOWN:
                reached.append(str(topic))
    for kind in ("simulator", "robot_bridge"):
        for question in QUESTIONS:
            given += 1
            replies = operator.get(f"{rig.root(kind)}/{question}", timeout=ASKED_S)
            reached += [question for reply in replies if reply.ok is not None]
    present = set(rig.connection.present()) & {"simulator/main", f"robot_bridge/{ARM}"}
    for declared in kept:
        declared.undeclare()
    crashed = len(rig.ended())
    return [
        Row("commands given by an agent", asked, answers, crashed=crashed, barred=True),
        Row("commands and questions answered for another", given, len(reached), crashed=crashed, barred=True),
        Row("presence of another", 2, len(present), crashed=crashed, barred=True),
    ]
