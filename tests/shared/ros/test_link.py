"""What a robot's link does where the Zenoh of the other end is lost."""

import contextlib

from shared.ros.link import Heard, RosLink
from shared.ros.naming import Ros2dds
from shared.ros.types import STRING
from shared.runtime.session import SessionSettings, free_local_endpoint, open_router, open_session


def test_a_session_whose_link_broke_is_not_used_again_and_another_one_is_opened(until):
    settings, heard = SessionSettings(endpoint=free_local_endpoint()), []
    topics = (Heard("PSM1/error", STRING, lambda data, _at_ns: heard.append(data)),)
    with contextlib.closing(RosLink(settings, Ros2dds(), topics)) as link:
        with open_router(settings.endpoint):
            link.open()
            until(link.reaches)
            before = link._session
        until(lambda: link.broken == 1)
        with open_router(settings.endpoint), open_session(settings) as console:
            until(link.reaches)
            assert link._session is not before
            until(lambda: console.put("PSM1/error", b"said") or heard)
