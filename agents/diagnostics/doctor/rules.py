"""The proof of a rig's access rules, by trying with every certificate of this host."""

import contextlib
from collections.abc import Iterator

from agents.configuration.hosts import BESIDE, OPERATOR, kind_and_instance
from agents.configuration.reading_session import certificate_names, session_as
from agents.configuration.rig import RigConfig
from agents.diagnostics.doctor.finding import UNKNOWN, Finding
from shared.runtime.access import Trial, try_command, try_rules
from shared.runtime.config import ConfigError
from shared.runtime.connection import NoRouterError, open_when_there
from shared.runtime.session import on_loopback

OPENS_WITHIN_S = 3.0
REMEDY = "run the router with the configuration that suturegrasp deploy plan makes, and look who may have got in"


def examine_rules(rig: RigConfig, present: list[str]) -> Iterator[Finding]:
    """Try what each certificate of this host may do and what it may not; `present` are agents, as `kind/instance`."""
    what = "access rules"
    if rig.security is None:
        where = "on this machine alone" if on_loopback(rig.router_endpoint) else rig.router_endpoint
        open_to_all = f"none are in force: the router listens {where}, where every program may speak for every agent"
        yield Finding(what, f"{open_to_all}; that suits one machine whose users trust each other")
        return
    names = certificate_names(rig.security.certificates)
    for name in names:
        # a listener with another certificate, where there is one, is nearer to what other agents hear
        listener = next((other for other in names if other != name), name)
        yield _tried(rig, name, listener, present)


def _tried(rig: RigConfig, name: str, listener: str, present: list[str]) -> Finding:
    what, own = f"access rules for {name}", name.replace(".", "/", 1)
    kind = name.split(".")[0]
    others = [root for root in _roots(rig) if root != own and not root.startswith(f"{OPERATOR}/")]
    agents = [root for root in present if root != own and root.split("/")[0] not in (*BESIDE, "guard")]
    with contextlib.ExitStack() as stack:
        try:
            trier, hearer = (
                stack.enter_context(open_when_there(session_as(rig, n), OPENS_WITHIN_S)) for n in (name, listener)
            )
        except (NoRouterError, ConfigError) as error:
            return Finding(what, f"{UNKNOWN}, for the router was not reached: {error}")
        trial = try_rules(trier, hearer, rig.rig, own, others)
        asked = try_command(trier, rig.rig, agents[0]) if agents else None
    return verdict(what, trial, asked, kind == OPERATOR, agents[0] if agents else "")


def verdict(what: str, trial: Trial, asked: bool | None, may_command: bool, agent: str) -> Finding:
    """What a trial shows; `asked` says whether a command reached the agent, None where none could be tried."""
    if trial.leaked:
        return Finding(what, f"not in force: {', '.join(trial.leaked)} arrived, and must not", REMEDY)
    if asked and not may_command:
        return Finding(what, f"not in force: a command of it reached {agent}, which operators alone may send", REMEDY)
    if not trial.arrived:
        refused = "what it may say did not arrive either, so that nothing is known of what it may not"
        return Finding(what, refused, "is it in the router's rules? make them anew with suturegrasp deploy plan")
    if may_command and asked is False:
        return Finding(what, f"too narrow: no command reached {agent}, which an operator may send", REMEDY)
    own = "what is its own arrived"
    told = {None: "; commands were not tried, for no agent runs", True: ", and so did a command"}.get(asked, "")
    told = "; a command of it was denied" if asked is False else told
    return Finding(
        what, f"in force: {own}{told}; {trial.denied} ways to speak for others were denied, histories included"
    )


def _roots(rig: RigConfig) -> list[str]:
    """Every agent of the rig, as `kind/instance`."""
    if not rig.hosts:
        return ["/".join(kind_and_instance(name)) for name in rig.processes()]
    names = {kind_and_instance(name, host) for host, section in rig.hosts.items() for name in section.runs}
    return sorted("/".join(name) for name in names)
