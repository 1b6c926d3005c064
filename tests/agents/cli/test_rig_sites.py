"""What a rig's file says about routers of other sites, and what follows for its router."""

import pytest

from agents.configuration.rig import RigConfig
from shared.runtime.access import Sites
from shared.runtime.config import ConfigError, parse_config

SECURED = '"security": {}, "host": "desk", "hosts": {"desk": {"address": "10.0.0.1", "runs": ["operator"]}}'


def rig_with(router, beside=""):
    return parse_config(f'{{"rig": "south", "router": {{{router}}}{beside}}}', RigConfig, "rig.json")


def test_a_router_links_to_what_its_file_says_and_otherwise_to_nothing():
    assert RigConfig().sites == Sites((), (), read_by_others=False)
    router = '"host": "desk", "connect": ["tls/10.0.0.9:7447"], "reads": ["north"], "read_by_others": true'
    assert rig_with(router, f", {SECURED}").sites == Sites(("tls/10.0.0.9:7447",), ("north",), read_by_others=True)


def test_no_link_leaves_this_machine_without_certificates():
    with pytest.raises(ConfigError, match=r"router.connect 'tcp/10.0.0.9:7447' leaves this machine"):
        rig_with('"connect": ["tcp/10.0.0.9:7447"]')
    with pytest.raises(ConfigError, match=r"needs tls and \[security\]"):
        rig_with('"host": "desk", "connect": ["tcp/10.0.0.9:7447"]', f", {SECURED}")
    assert rig_with('"connect": ["tcp/127.0.0.1:7448"]').sites.connect == ("tcp/127.0.0.1:7448",)


def test_a_rig_is_not_another_sites():
    with pytest.raises(ConfigError, match=r"router.reads names 'south', this rig itself"):
        rig_with('"reads": ["south"]')
