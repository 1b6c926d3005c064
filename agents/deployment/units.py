"""systemd units of a host: one for each process, and a target for all of them.

Each process has a user of its own, and reads its own key only, through LoadCredential=; it says by sd_notify when it is
ready and, from its loop, that it lives. Nothing gains privileges, and nothing but a recorder may write.
"""

import hashlib
from pathlib import PurePosixPath

from agents.deployment.layout import ROUTER, Host, Process
from agents.deployment.places import CERTIFICATES, GROUP, HOME, PROGRAM, RIG_FILE, SESSIONS
from agents.deployment.robot_zenoh import ROBOT_ZENOH
from agents.registry import AGENTS, GUARD, ROBOT_BRIDGE, Kind, Pace, command_of, kind_of
from shared.runtime.identity import AUTHORITY_FILE

TARGET = "suturegrasp.target"
LONGEST_USER = 31
WATCHDOG_S = 10
"""A loop that says nothing for so long hangs; its longest wait is half a second, and its longest step a few."""
WATCHDOG_OF_COMPUTING_S = 60
"""Of what drives nothing, and whose first step takes longest: where others have the processor, it would be killed in it
each time, and never get beyond it."""
REALTIME_PRIORITY = 50
PEOPLE = "operator"
NOT_OURS = (PEOPLE, ROBOT_ZENOH)
"""Has a certificate and no process of ours: commands run as long as somebody needs them, the robot's Zenoh by ROS."""
HARDENED = """\
NoNewPrivileges=yes
PrivateTmp=yes
ProtectSystem=strict
ProtectHome=yes
ProtectHostname=yes
ProtectClock=yes
ProtectKernelTunables=yes
ProtectKernelModules=yes
ProtectKernelLogs=yes
ProtectControlGroups=yes
ProtectProc=invisible
RestrictNamespaces=yes
RestrictSUIDSGID=yes
RestrictAddressFamilies=AF_UNIX AF_INET AF_INET6
LockPersonality=yes
RemoveIPC=no
CapabilityBoundingSet=
SystemCallArchitectures=native
SystemCallFilter=@system-service
UMask=0027
"""


def row_of(process: Process) -> Kind | None:
    """The row of the registry that a process is of; None for a router, which is no program of ours."""
    return kind_of(process.kind)


def names_its_arm(process: Process) -> bool:
    """Whether a process is one of an arm's."""
    kind = row_of(process)
    return kind is not None and kind.per_arm


def command_line(process: Process, session: PurePosixPath) -> str:
    """What a process is started by; `session` is the folder that it writes to, where it writes."""
    kind = row_of(process)
    if kind is None:
        return process.kind
    return command_of(kind).format(instance=process.instance, session=session / kind.writes)


def keeps_time(host: Host, process: Process) -> bool:
    """Whether a process may ask for real-time priority on a host; others would take the processor from it."""
    kind = row_of(process)
    return host.realtime and kind is not None and kind.pace is Pace.KEEPS_TIME


def unit_name(process: Process) -> str:
    """File name of the unit of a process."""
    ending = f"-{process.instance}" if names_its_arm(process) else ""
    return f"suturegrasp-{process.kind.replace('_', '-')}{ending}.service"


def user_of(process: Process) -> str:
    """The system user that a process runs as: one of its own, of at most the 31 letters that such a name may have."""
    name = unit_name(process).removesuffix(".service")
    if len(name) <= LONGEST_USER:
        return name
    told_apart = hashlib.sha256(name.encode()).hexdigest()[:6]
    return f"{name[: LONGEST_USER - 7]}-{told_apart}"


def units(rig: str, host: Host) -> dict[str, str]:
    """Every unit of a host, by file name."""
    services = {unit_name(p): _service(rig, host, p) for p in host.processes if p.kind not in NOT_OURS}
    target = (
        "[Unit]\n"
        f"Description=SutureGrasp, rig {rig}, host {host.name}\n"
        f"Wants={' '.join(services)}\n\n"
        "[Install]\nWantedBy=multi-user.target\n"
    )
    return {**services, TARGET: target}


def _service(rig: str, host: Host, process: Process) -> str:
    command = command_line(process, state_of(process))
    name = process.common_name
    credentials = (AUTHORITY_FILE, f"{name}.pem", f"{name}.key")
    sections = (
        "[Unit]",
        f"Description=SutureGrasp {process.kind} {process.instance} of rig {rig}",
        "Wants=network-online.target",
        "After=network-online.target time-sync.target",
        f"PartOf={TARGET}",
        *_order(host, process),
        "# it may be away for as long as it takes: nothing is given up",
        "StartLimitIntervalSec=0",
        "",
        "[Service]",
        "Type=notify",
        f"ExecStart={PROGRAM} {command} --config {HOME / RIG_FILE} --host {host.name}",
        f"User={user_of(process)}",
        f"Group={GROUP}",
        *(f"LoadCredential={file}:{CERTIFICATES / file}" for file in credentials),
        "# ready once it has found the router, however long that takes",
        "TimeoutStartSec=infinity",
        *_watchdog(process),
        "TimeoutStopSec=15",
        "# Zenoh keeps the shared memory that images go through from being paged out",
        "LimitMEMLOCK=infinity",
        "Restart=on-failure",
        "# a configuration at fault is not mended by starting again",
        "RestartPreventExitStatus=2",
        "RestartSec=0.5",
        "# systemd before 254 does not know the next two, says so, and waits half a second each time",
        "RestartSteps=5",
        "RestartMaxDelaySec=10",
        *_priority(host, process),
        *_storage(process),
        *_devices(process),
        HARDENED,
    )
    return "\n".join(sections)


def _order(host: Host, process: Process) -> tuple[str, ...]:
    """A guard is there before the bridge that it guards, and goes after it."""
    guarded = Process(ROBOT_BRIDGE.name, process.instance)
    return (f"Before={unit_name(guarded)}",) if row_of(process) is GUARD and guarded in host.processes else ()


def _watchdog(process: Process) -> tuple[str, ...]:
    kind = row_of(process)
    if kind not in (*AGENTS, GUARD):
        return ()
    return (f"WatchdogSec={WATCHDOG_OF_COMPUTING_S if kind.pace is Pace.STEPS_BACK else WATCHDOG_S}",)


def _priority(host: Host, process: Process) -> tuple[str, ...]:
    if keeps_time(host, process):
        # it asks for itself, for the loop's thread alone
        return (f"LimitRTPRIO={REALTIME_PRIORITY}",)
    return ("RestrictRealtime=yes",)


def _storage(process: Process) -> tuple[str, ...]:
    own = f"{SESSIONS.name}/{state_of(process).name}"
    kept = (f"StateDirectory={own}", "StateDirectoryMode=0750")
    kind = row_of(process)
    if kind is not None and kind.writes:
        return (*kept, f"WorkingDirectory={state_of(process)}")
    if kind is not None and kind.audited:
        return (*kept, f"WorkingDirectory={HOME}")
    return (f"WorkingDirectory={HOME}",)


def state_of(process: Process) -> PurePosixPath:
    """Where a process keeps what it writes, which is its own."""
    return SESSIONS / unit_name(process).removesuffix(".service").removeprefix("suturegrasp-")


def _devices(process: Process) -> tuple[str, ...]:
    kind = row_of(process)
    if kind is not None and kind.films:
        return ("DevicePolicy=closed", "DeviceAllow=char-video4linux rw", "SupplementaryGroups=video")
    return ("PrivateDevices=yes",) if process.kind != ROUTER else ("PrivateDevices=yes", "LimitNOFILE=65536")
