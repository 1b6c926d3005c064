"""`suturegrasp doctor`: what would keep a rig from running, here and across its hosts, each with its remedy."""

import contextlib
import importlib.metadata
import json
import socket
from collections.abc import Iterator

import schemas
from agents.cli.live.options import Doctor
from agents.cli.live.status import gathered_on
from agents.configuration.reading_session import reading_session
from agents.configuration.rig import RigConfig
from agents.diagnostics.doctor.finding import Finding
from agents.diagnostics.doctor.here import examine_here
from agents.diagnostics.doctor.images import PairFiles, examine_frames, examine_images
from agents.diagnostics.doctor.rig import clocks, files, granted, guards, links, running, streams, topics, versions
from agents.diagnostics.doctor.router import no_router
from agents.diagnostics.doctor.rules import examine_rules
from agents.diagnostics.status.watch import StatusWatch
from agents.diagnostics.status.wrong import listed
from agents.launch.process import EXIT_OK
from schemas.wire import schemas_hash
from shared.runtime.connection import Connection, NoRouterError, connected
from shared.runtime.identity import IdentityError
from shared.terminal import UsageError, say, show

EXIT_FOUND = 1
ROUTER_WAIT_S = 2.0
LONGEST_S = 600.0


def doctor(rig: RigConfig, options: Doctor) -> int:
    """Print every finding; the exit status is 1 where something is wrong."""
    findings: list[Finding] = []
    pair = PairFiles(options.left, options.right, options.stereo, options.calibration, options.unit)
    for finding in _examined(rig, options, pair):
        findings.append(finding)
        if not options.json:
            remedy = f"; {finding.remedy}" if finding.remedy else ""
            say(f"{finding.state:5}  {finding.what}: {finding.found}{remedy}")
    well = not any(finding.remedy for finding in findings)
    if options.json:
        told = [{"what": f.what, "state": _STATES[f.state], "found": f.found, "remedy": f.remedy} for f in findings]
        of = {} if pair.given else {"rig": rig.rig, "host": rig.host}
        show(json.dumps({**of, "well": well, "findings": told}))
    return EXIT_OK if well else EXIT_FOUND


def _examined(rig: RigConfig, options: Doctor, pair: PairFiles) -> Iterator[Finding]:
    if options.arm is None:
        return examine_images(pair) if pair.given else examine(rig)
    if pair.given:
        raise UsageError("give a pair of images or --arm, not both")
    if not 1 <= options.seconds <= LONGEST_S:
        raise UsageError(f"--seconds {options.seconds:g} is not between 1 and {LONGEST_S:g}")
    # reading ROS messages takes as long to load as all else
    from agents.diagnostics.doctor.console import examine_console

    return examine_console(rig, options.arm, options.seconds)


_STATES = {"ok": "ok", "WRONG": "wrong", "?": "unknown"}


def examine(rig: RigConfig) -> Iterator[Finding]:
    """Look at everything in turn: this machine, then the router, then the rig behind it."""
    yield from examine_here(rig)
    settings = reading_session(rig)
    try:
        with connected(settings, ROUTER_WAIT_S) as connection:
            yield Finding("router", f"answers on {rig.router_endpoint}")
            yield from _across(rig, connection)
            present = connection.present()
    except NoRouterError:
        yield no_router(rig, settings)
    except IdentityError as error:
        yield Finding("router", f"not reached on {rig.router_endpoint}", str(error))
    else:
        yield from examine_rules(rig, present)


def _across(rig: RigConfig, connection: Connection) -> Iterator[Finding]:
    with contextlib.closing(StatusWatch(connection, rig)) as watch:
        gathered = gathered_on(watch)
    yield from running(rig, gathered.fares, rig.host or "", gathered.other_rigs)
    if gathered.replayed:
        # which tells of the recording, and not of how the rig fares now
        yield Finding("replay", f"a recording is replayed into this rig, and stands for {listed(gathered.replayed)}")
        gathered = gathered.without_replayed()
    yield from guards(rig, gathered)
    facts = gathered.facts
    zenoh = importlib.metadata.version("eclipse-zenoh")
    yield from versions(facts, schemas.__version__, schemas_hash(), zenoh)
    yield from topics(rig, facts)
    yield from files(gathered)
    yield from clocks(gathered.clocks, socket.gethostname())
    yield from links({name: connection.link(*name.split("/")) for name in facts})
    yield from streams(gathered)
    yield from examine_frames(connection)
    yield from granted(facts, rig, gathered.at_ns)
