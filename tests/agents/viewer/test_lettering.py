import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from agents.viewer.image_pane import ascii_text, text_width, wrapped
from agents.viewer.picture import nice_ticks


def test_signs_are_spelled_out_accents_dropped_and_all_else_becomes_a_question_mark():
    assert ascii_text("30° ± 2 µm − café × 3 — „ε_z“ 糸") == '30 deg +- 2 um - cafe x 3 - "eps_z" ?'


@given(text=st.text(max_size=80), width=st.integers(40, 400))
def test_any_text_is_wrapped_to_lines_of_printable_ascii_that_fit_and_lose_no_letter(text, width):
    lines = wrapped(text, width)
    assert all(text_width(line) <= width for line in lines)
    assert all(" " <= letter <= "~" for letter in "".join(lines))
    assert "".join(lines).replace(" ", "") == ascii_text(text).replace(" ", "")


@given(low=st.floats(-1e4, 1e4), span=st.floats(1e-2, 1e5))
def test_ticks_are_few_even_and_within_the_range(low, span):
    ticks = np.array(nice_ticks(low, low + span, about=8))
    assert 2 <= len(ticks) <= 9
    assert (ticks >= low - 1e-9 * span).all()
    assert (ticks <= low + span * (1 + 1e-9)).all()
    assert np.allclose(np.diff(ticks), ticks[1] - ticks[0], rtol=1e-6)
