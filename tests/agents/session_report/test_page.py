"""The page: one file without anything from elsewhere, whatever the recording says; charts and pictures in it."""

import dataclasses
import html.parser
import re
import xml.etree.ElementTree as ElementTree

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from agents.session_report.page import WIDTH, Mark, Series, chart, nice_ceiling, session_page, thinned
from agents.session_report.pictures import pictures_of
from agents.session_report.session import read_session
from tests.agents.session_report.conftest import ns


class Outline(html.parser.HTMLParser):
    """Tags that are open, and every address that a page names."""

    VOID = ("meta", "img", "link", "br")

    def __init__(self):
        super().__init__()
        self.open, self.addresses, self.tags = [], [], set()

    def handle_starttag(self, tag, attrs):
        self.tags.add(tag)
        self.addresses += [value for name, value in attrs if name in ("src", "href", "data", "srcset")]
        if tag not in self.VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag, attrs):
        self.tags.add(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag


def test_every_tag_is_closed_nothing_comes_from_elsewhere_nor_runs_and_charts_stay_within_their_frame(recording):
    session = read_session(recording)
    page = "".join(session_page(session, pictures_of(session)))
    outline = Outline()
    outline.feed(page)
    assert outline.open == []
    assert {"table", "svg", "polyline", "img"} <= outline.tags
    assert not {"script", "link", "iframe"} & outline.tags
    assert all(address.startswith("data:image/jpeg;base64,") for address in outline.addresses)
    assert "url(" not in page
    assert "http" not in page.replace("http-equiv", "")
    # what agents say is text and nothing else
    assert "&lt;script&gt;alert(1)&lt;/script&gt; [bold]?[31m" in page
    figures = re.findall(r"<svg.*?</svg>", page)
    assert len(figures) == 5
    for figure in figures:
        lines = [one.get("points", "") for one in ElementTree.fromstring(figure).iter("polyline")]  # noqa: S314
        points = np.array([pair.split(",") for line in lines for pair in line.split()], float)
        assert len(points) and (points >= 0).all() and (points[:, 0] <= WIDTH).all()


def test_pictures_show_what_the_camera_saw_with_the_thread_drawn_in(recording):
    pictures = pictures_of(read_session(recording))
    assert [picture.of.what for picture in pictures] == [
        *("planned from", "accepted", "approach", "capture", "slide", "grasp", "retreat", "finished", "judged")
    ]
    planned = pictures[0]
    image = cv2.imdecode(np.frombuffer(planned.jpeg, np.uint8), cv2.IMREAD_COLOR)
    assert image is not None
    assert image.shape == (54, 96, 3)
    # the thread runs through the middle of the image, from u = 27.5 to 67.5
    blue, green, red = planned.pixels[26:28, 30:64].astype(int).max(axis=0).T
    assert (green - np.maximum(blue, red) > 60).mean() > 0.7
    assert (planned.pixels[5] == planned.pixels[5, 0]).all()
    assert planned.captured_ns == pytest.approx(ns(17 / 30), abs=2)


def test_of_a_recording_without_images_and_a_chart_of_nothing_known_a_page_is_made_all_the_same(maker, tmp_path):
    session = read_session(maker.write(tmp_path / "empty.mcap"))
    assert pictures_of(session) == []
    assert "0 messages on 0 keys" in "".join(session_page(session, []))
    figure = chart("nothing", [Series("a", np.array([1.0]), np.array([np.nan]))], 2.0, [Mark(1.0, "<b>")])
    assert "&lt;b&gt;" in figure
    assert "polyline" not in figure


@given(seed=st.integers(0, 1000), count=st.integers(1, 3000), bins=st.integers(1, 50))
def test_thinning_keeps_the_least_and_the_largest_and_the_order(seed, count, bins):
    values = np.random.default_rng(seed).normal(0, 100, count)
    at_s, kept = thinned(np.arange(len(values), dtype=float), values, bins)
    assert (kept.min(), kept.max()) == (min(values), max(values))
    assert (np.diff(at_s) > 0).all()
    assert len(kept) <= 2 * bins
    assert (values[at_s.astype(int)] == kept).all()


@given(value=st.floats(1e-9, 1e9))
def test_an_axis_ends_a_little_above_its_largest_value(value):
    assert value * (1 - 1e-6) <= nice_ceiling(value) <= 2.5 * value * (1 + 1e-6)


@pytest.mark.parametrize("wrong_ns", [0, 2**64 - 1])
def test_one_clock_that_is_decades_off_makes_no_page_of_decades(a_session, tmp_path, wrong_ns):
    whole = a_session()
    topic, entry = whole.entries[-1]
    whole.entries[-1] = topic, dataclasses.replace(entry, published_ns=wrong_ns)
    session = read_session(whole.write(tmp_path / "a.mcap"))
    assert abs(wrong_ns - session.start_ns) > 1e17
    assert len("".join(session_page(session, []))) < 200_000
