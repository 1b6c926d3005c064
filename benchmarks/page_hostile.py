"""Hostile clients of the page: malformed requests and frames, other origins, names, tokens and secrets played again."""

import contextlib
import json
import random
from dataclasses import dataclass
from typing import Any

import aiohttp
import yarl

from agents.operator.wire import KINDS

OURS_AFTER = 200
"""Requests after which a new connection is taken: a hostile client keeps none."""


@dataclass
class Attack:
    """What was tried and what was let in."""

    name: str
    sent: int = 0
    refused: int = 0
    let_in: int = 0


async def attacked(address: str, used_token: str, used_secret: str, count: int, seed: int) -> list[Attack]:
    """So many of each against a server; a token and a secret that were used are played again."""
    rng = random.Random(seed)  # noqa: S311 - the same attacks each time
    ours = {"Origin": address.rstrip("/")}
    attacks: list[Attack] = []
    async with aiohttp.ClientSession() as session:
        attacks.append(await _requests(session, address, ours, count, rng))
        attacks.append(await _origins(session, address, used_token, count // 10))
        attacks.append(await _tokens(session, address, ours, used_token, count // 10, rng))
        attacks.append(await _secrets(session, address, ours, used_secret, count // 10, rng))
        attacks.append(await _frames(session, address, ours, count, rng))
    return attacks


async def _requests(
    session: aiohttp.ClientSession, address: str, ours: dict[str, str], count: int, rng: random.Random
) -> Attack:
    attack = Attack("malformed requests")
    for _ in range(count):
        method = rng.choice(["GET", "POST", "PUT", "DELETE", "OPTIONS", "PATCH"])
        path = rng.choice(["session", "ws", "page/..%2fdesk.py", "operator/arm", "%00", "session?token=x"])
        body = rng.randbytes(rng.randrange(600)) if rng.random() < 0.5 else json.dumps(_fields(rng)).encode()
        attack.sent += 1
        try:
            url = yarl.URL(address + path, encoded=True)
            async with session.request(method, url, data=body, headers=ours) as answer:
                attack.refused += answer.status >= 400
                attack.let_in += answer.status < 400
        except aiohttp.ClientError:
            attack.refused += 1
    return attack


async def _origins(session: aiohttp.ClientSession, address: str, token: str, count: int) -> Attack:
    attack, host = Attack("other origins and names"), yarl.URL(address)
    others = [
        {},
        {"Origin": "null"},
        {"Origin": "http://evil.example"},
        {"Origin": f"https://{host.host}:{host.port}"},
        {"Origin": f"http://{host.host}:1"},
        {"Origin": address.rstrip("/"), "Sec-Fetch-Site": "cross-site"},
        {"Origin": f"http://evil.example:{host.port}", "Host": f"evil.example:{host.port}"},
    ]
    for i in range(count):
        attack.sent += 1
        try:
            if i % 2:
                await session.ws_connect(f"{address}ws", headers=others[i % len(others)])
                attack.let_in += 1
            else:
                url = f"{address}session"
                async with session.post(url, json={"token": token}, headers=others[i % len(others)]) as answer:
                    attack.refused += answer.status >= 400
                    attack.let_in += answer.status < 400
        except aiohttp.ClientError:
            attack.refused += 1
    return attack


async def _tokens(
    session: aiohttp.ClientSession, address: str, ours: dict[str, str], used: str, count: int, rng: random.Random
) -> Attack:
    attack = Attack("tokens played again or made up")
    for i in range(count):
        token = used if i % 2 else used[:-1] + rng.choice("abcdef")
        attack.sent += 1
        async with session.post(f"{address}session", json={"token": token}, headers=ours) as answer:
            attack.refused += answer.status == 403
            attack.let_in += answer.status < 400
    return attack


async def _secrets(
    session: aiohttp.ClientSession, address: str, ours: dict[str, str], used: str, count: int, rng: random.Random
) -> Attack:
    attack = Attack("secrets played again or made up")
    for i in range(count):
        secret = used if i % 2 else used[:-1] + rng.choice("abcdef")
        attack.sent += 1
        async with session.ws_connect(f"{address}ws", headers=ours) as socket:
            await socket.send_json({"kind": "hello", "secret": secret})
            with contextlib.suppress(ConnectionError):
                await socket.send_json({"kind": "hold"})
            message = await socket.receive()
            closed = message.type in (aiohttp.WSMsgType.CLOSE, aiohttp.WSMsgType.CLOSED, aiohttp.WSMsgType.ERROR)
            attack.refused += closed
            attack.let_in += not closed
    return attack


async def _frames(
    session: aiohttp.ClientSession, address: str, ours: dict[str, str], count: int, rng: random.Random
) -> Attack:
    """Frames of the WebSocket without a secret, malformed and well-formed."""
    attack = Attack("frames without a secret, malformed or not")
    while attack.sent < count:
        try:
            async with session.ws_connect(f"{address}ws", headers=ours) as socket:
                for _ in range(10):
                    attack.sent += 1
                    if rng.random() < 0.3:
                        await socket.send_bytes(rng.randbytes(rng.randrange(5000)))
                    else:
                        await socket.send_str(json.dumps(_fields(rng)))
                message = await socket.receive()
                attack.let_in += message.type in (aiohttp.WSMsgType.TEXT, aiohttp.WSMsgType.BINARY)
        except (aiohttp.ClientError, ConnectionError):
            pass
    attack.refused = attack.sent - attack.let_in
    return attack


def _fields(rng: random.Random) -> dict[str, Any]:
    odd: list[Any] = [None, True, -1, 1e308, "psm1", "x" * 300, [], {}, [1, 2], "\ud800", "plan-1"]
    names = ["kind", "arm", "plan_id", "s", "pixel", "frame", "policy", "challenge", "secret", "yes", "on"]
    return {"kind": rng.choice(list(KINDS))} | {name: rng.choice(odd) for name in rng.sample(names[1:], 4)}
