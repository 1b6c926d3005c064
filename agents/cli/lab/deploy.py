"""`suturegrasp deploy plan | certificates | install | rehearse`: from a rig's one file to what runs on each host."""

import datetime
import shutil
from pathlib import Path, PurePosixPath

from agents.cli.lab.options import Deploy
from agents.configuration.hosts import OPERATOR, HostSection, kind_and_instance
from agents.configuration.rig import RigConfig
from agents.configuration.this_host import recognised
from agents.deployment.certificates import CERTIFICATES, issue
from agents.deployment.install import install
from agents.deployment.layout import ROUTER, Host, Layout, Process
from agents.deployment.leftovers import remove_leftovers
from agents.deployment.places import AUTHORITY_FOLDER, RIG_FILE
from agents.deployment.plan import hosts_in_words, plan
from agents.deployment.robot_zenoh import ROBOT_ZENOH, ReachedArm
from agents.launch.process import EXIT_OK
from shared.clock import now_ns
from shared.runtime.config import ConfigError, load_config
from shared.runtime.session import on_loopback
from shared.terminal import say

INSTALL = "suturegrasp deploy install --folder FOLDER, as root"


def run(options: Deploy) -> int:
    """Carry out one of the four; the exit status."""
    if options.action == "install":
        return _install(options)
    rig = load_config(options.config, RigConfig)
    layout = layout_of(rig)
    if options.action == "rehearse":
        # it needs what nobody else does: namespaces, emulated consoles
        from agents.cli.lab.rehearsal.rehearse import rehearse

        return rehearse(options, rig)
    if options.action == "plan":
        return _plan(options, rig, layout)
    return _certificates(options, layout)


def layout_of(rig: RigConfig) -> Layout:
    """The rig as its deployment sees it.

    Raises:
        ConfigError: where it has no hosts, or is one host's own copy.
    """
    if not rig.hosts or rig.security is None:
        raise ConfigError("the configuration has no [hosts]; on one machine suturegrasp up is all that is needed")
    if rig.host is not None:
        raise ConfigError(f"this is the copy for host {rig.host}; give the rig's own file, without its line host = ...")
    hosts = tuple(_host(rig, name, section) for name, section in rig.hosts.items())
    return Layout(
        rig.rig,
        rig.router_endpoint,
        hosts,
        rig.security.leaf_days,
        rig.security.authority_days,
        _relative_calibration(rig),
        rig.sites,
    )


def _host(rig: RigConfig, name: str, section: HostSection) -> Host:
    processes = [Process(*kind_and_instance(run, name)) for run in section.runs]
    if rig.router.host == name:
        processes.insert(0, Process(ROUTER))
    arms = _arms_at(rig, name, section)
    if arms and not on_loopback(arms[0].endpoint):
        processes.append(Process(ROBOT_ZENOH, name))
    return Host(name, section.address, tuple(processes), section.realtime, arms)


def _arms_at(rig: RigConfig, name: str, section: HostSection) -> tuple[ReachedArm, ...]:
    """The arms whose consoles run on a host.

    Raises:
        ConfigError: where they are not reached alike, for one Zenoh is there for all of them.
    """
    told = {arm: s.dvrk for arm, s in rig.robot.items() if s.dvrk is not None and f"guard {arm}" in section.runs}
    alike = {(dvrk.endpoint, dvrk.codec, dvrk.domain) for dvrk in told.values()}
    if len(alike) > 1:
        raise ConfigError(f"{', '.join(told)} on {name} must have one endpoint, codec and domain: one Zenoh is there")
    return tuple(ReachedArm(arm, d.arm, d.endpoint, d.codec, d.domain) for arm, d in told.items())


def _plan(options: Deploy, rig: RigConfig, layout: Layout) -> int:
    beside = [*_calibration(options, rig), *_of_arms(options, rig)]
    files = plan(layout, options.config.read_text(encoding="utf-8"))
    for place, text in files.items():
        target = options.folder / place
        target.parent.mkdir(parents=True, exist_ok=True)
        target.write_text(text, encoding="utf-8")
    for source, place in beside:
        target = options.folder / place
        target.parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(source, target)
    removed = remove_leftovers(options.folder, rig.rig, (*files, *(PurePosixPath(place) for _, place in beside)))
    for place in removed:
        say(f"removed {place}, which is in the rig's plan no more")
    for line in hosts_in_words(layout):
        say(line)
    if not any(process.kind == OPERATOR for host in layout.hosts for process in host.processes):
        say(f'note: no host runs "{OPERATOR}", so nobody may give commands')
    say(f"{len(files) + len(beside)} files in {options.folder}; next: suturegrasp deploy certificates")
    return EXIT_OK


def _calibration(options: Deploy, rig: RigConfig) -> list[tuple[Path, Path]]:
    """The calibration, which goes to the camera's host with the rig's file."""
    calibration = _relative_calibration(rig)
    if not calibration:
        return []
    source = options.config.parent / calibration
    if not source.is_file() or ".." in Path(calibration).parts:
        raise ConfigError(f"camera.calibration {calibration} is no file beside {options.config} or below")
    hosts = [name for name, section in rig.hosts.items() if "camera" in section.runs]
    return [(source, Path(host) / calibration) for host in hosts]


def _of_arms(options: Deploy, rig: RigConfig) -> list[tuple[Path, Path]]:
    """Where an arm's base is and where its jaw closes, as files, which go to the host of the arm's bridge."""
    found: list[tuple[Path, Path]] = []
    for arm, section in rig.robot.items():
        hosts = [name for name, host in rig.hosts.items() if f"robot_bridge {arm}" in host.runs]
        for key, file in (("T_camera_base_file", section.T_camera_base_file), ("jaw_file", section.jaw_file)):
            if file is None or file.is_absolute():
                continue
            source = options.config.parent / file
            if source.is_file() and ".." not in file.parts:
                found += [(source, Path(host) / file) for host in hosts]
            else:
                say(f"note: robot.{arm}.{key} {file} is no file beside {options.config}: put it on the bridge's host")
    return found


def _relative_calibration(rig: RigConfig) -> str:
    """Where the calibration lies beside the rig's file; empty where there is none, or where every host has it."""
    calibration = rig.camera.calibration if rig.camera is not None else None
    return "" if calibration is None or calibration.is_absolute() else calibration.as_posix()


def _certificates(options: Deploy, layout: Layout) -> int:
    at = datetime.datetime.fromtimestamp(now_ns() * 1e-9, datetime.UTC)
    issued = issue(layout, options.folder, at, options.anew)
    for made in issued:
        if made.reason:
            say(f"{made.host}: {made.common_name}, until {made.valid_until:%Y-%m-%d}; {made.reason}")
    renewed = sum(1 for made in issued if made.reason)
    say(f"{renewed} certificates made, {len(issued) - renewed} still good")
    say(f"keep {options.folder / AUTHORITY_FOLDER} here and private: whoever has its key may be any agent")
    say(f"next: copy each host's folder to it ({CERTIFICATES} included), and there: {INSTALL}")
    return EXIT_OK


def _install(options: Deploy) -> int:
    done = install(options.folder, _host_of(options.folder, options.root), options.root)
    for place in done.changed:
        say(f"installed {place}")
    for unit in done.removed:
        say(f"removed {unit}")
    for note in done.notes:
        say(f"note: {note}")
    if not done.changed and not done.removed:
        say("nothing has changed")
    return EXIT_OK


def _host_of(folder: Path, root: Path) -> Host:
    """The host whose part of the plan lies in a folder.

    Raises:
        ConfigError: where that is nobody's part, or another host's than this machine. What is installed elsewhere than
            in / may be any host's.
    """
    file = folder / RIG_FILE
    if not file.is_file():
        raise ConfigError(
            f"{folder} has no {RIG_FILE}; give the folder of this host that suturegrasp deploy plan wrote"
        )
    rig = load_config(file, RigConfig)
    if rig.host not in rig.hosts:
        raise ConfigError(f"{file} is no host's part of a rig; give a folder that suturegrasp deploy plan wrote")
    here = recognised(rig.hosts)
    if here not in (None, rig.host):
        raise ConfigError(f"{folder} is the part of host {rig.host}, and this machine is {here}; install {here}'s here")
    if here is None and root == Path("/"):
        address = rig.hosts[rig.host].address
        raise ConfigError(
            f"{folder} is the part of host {rig.host} ({address}), and this machine has neither that address nor that "
            "name; install it there, or mend the address in the rig's file and plan anew"
        )
    layout = layout_of(rig.model_copy(update={"host": None}))
    return next(host for host in layout.hosts if host.name == rig.host)
