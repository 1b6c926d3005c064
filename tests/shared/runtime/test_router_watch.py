"""A link to the router that was down is told once it is up again."""

import contextlib

from shared.runtime.session import RouterWatch, SessionSettings, open_router, open_session


def test_a_router_that_was_away_is_told_once(router, until):
    said = []
    with contextlib.ExitStack() as stack:
        with router() as endpoint:
            session = stack.enter_context(open_session(SessionSettings("test", endpoint)))
            watch = RouterWatch(session, said.append)
            stack.callback(watch.undeclare)
            until(lambda: session.info.routers_zid(), "the link to be up")
        until(lambda: not session.info.routers_zid(), "the link to be down")
        assert not said
        stack.enter_context(open_router(endpoint))
        until(lambda: said, "the sentence")
    (sentence,) = said
    assert sentence.startswith("the link to the router broke")
