"""What the page on agents of one's own shows is Python that the project takes."""

import re
import sys
from pathlib import Path
from types import ModuleType
from typing import Any
from unittest.mock import patch

import numpy as np
import pytest
from pydantic import TypeAdapter, ValidationError

from agents.configuration.rig import section_made_of
from schemas.messages import Status
from shared.runtime.agent import Received
from tests.agents.viewer.conftest import CAMERA, STAMP

PAGE = (Path(__file__).parents[2] / "docs" / "new_agent.md").read_text(encoding="utf-8")
IMPORTS = """
from collections.abc import Iterable
from dataclasses import dataclass
import numpy as np
from jaxtyping import Float64
from pydantic import Field
from agents.registry import Kind, Pace
from schemas.checks import check_message, require
from schemas.messages import Consumed, FrameStamp, RectifiedStereo, Status
from schemas.shown import Shown, Shows
from schemas.topics import THREAD, Delivery, Topic
from shared.runtime.agent import Agent, Command, Input, Output, Received, Tick
from typing import Annotated
"""


def test_the_agent_of_the_page_steps():
    page: dict[str, Any] = {"__name__": "page"}
    exec(IMPORTS + "\n".join(re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL)), page)  # noqa: S102, it is ours
    ends = np.array(((0.0, 0.0, 90.0), (60.0, 0.0, 90.0)))
    known = page["ThreadSlack"](STAMP, CAMERA, Status.OK, "", 80.0, 60.0, ends)
    page["thread_slack"] = lambda *_: known
    agent = page["Slack"](page["SlackConfig"](points=50))
    (output,) = agent.step(Received(page["THREAD"], "suturegrasp/lab/reconstruction/main/thread", 1, "a thread"))
    assert (output.topic, output.message) == (page["SLACK"], known)
    assert known.shown().figures == {"length_mm": 80.0, "distance_mm": 60.0}
    failed = page["ThreadSlack"](STAMP, CAMERA, Status.FAILED, "no thread", 0.0, 0.0, None)
    assert failed.shown().state == "failed"


def test_the_section_of_the_page_follows_from_its_row():
    page: dict[str, Any] = {"__name__": "page"}
    exec(IMPORTS + "\n".join(re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL)), page)  # noqa: S102, it is ours
    module = ModuleType("agents.slack")
    module.__dict__["SlackConfig"] = page["SlackConfig"]
    with patch.dict(sys.modules, {"agents.slack": module}):
        section, default = section_made_of(page["SLACK"])
    assert default is None
    assert TypeAdapter(section).validate_python({}).points == 100
    with pytest.raises(ValidationError):
        TypeAdapter(section).validate_python({"points": 5})
