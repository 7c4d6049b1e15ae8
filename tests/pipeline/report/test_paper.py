"""The page for a work order: one sheet, with what the motor's page says first."""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations
from pathlib import Path

import matplotlib as mpl
import pytest
from matplotlib.figure import Figure

from pipeline.errors import UsageError
from pipeline.messages import statement
from pipeline.report.paper import STYLE, page_of, write_paper
from pipeline.report.tables import motor_histories
from tests.pipeline.report.conftest import demo_fleet
from tests.pipeline.report.states import state_of


def drawn(output: Path, motor_id: str) -> tuple[Figure, str]:
    """The page of a motor in alarm, and the words of its state."""
    (motor,) = motor_histories(output, [motor_id])
    state = state_of(motor_id, "alarm")
    with mpl.rc_context(STYLE):
        # More changes than there is room for: their words are cut after three lines.
        change = {"indicator": "leakage", "from_state": "ok", "to_state": "alarm"}
        changes = [change | {"night": night} for night in 5 * motor.nights]
        page = page_of(motor, state, demo_fleet(output).motor(motor_id), changes)
        page.canvas.draw()
    return page, statement(state.sentence, state.advice)


@pytest.mark.parametrize("motor_id", ["CB400-02", "CB1120-02"])
def test_page_says_what_happened_and_has_room_for_the_finding(
    fitted_output: Path, motor_id: str
) -> None:
    page, said = drawn(fitted_output, motor_id)
    words = " ".join(" ".join(text.get_text().split()) for text in page.texts)
    assert motor_id in words
    assert said in words
    assert "its own conditions: 150 bar, 48.0 °C, 26.0 rpm" in words
    assert words.count("not opened") == 4  # three gaps, and the cam rollers
    assert [axes.get_title("left") for axes in page.axes]
    # No text lies on another.
    boxes = [text.get_window_extent() for text in page.texts]
    boxes += [axes.get_tightbbox() for axes in page.axes]
    assert not any(one.overlaps(other) for one, other in combinations(boxes, 2))


def test_file_is_one_page_and_the_same_again(fitted_output: Path, tmp_path: Path) -> None:
    fleet = demo_fleet(fitted_output)
    path = write_paper(fleet, "CB400-02", tmp_path)
    content = path.read_bytes()
    assert content.startswith(b"%PDF-")
    assert content.count(b"/Type /Page ") + content.count(b"/Type /Page\n") == 1
    assert write_paper(fleet, "CB400-02", tmp_path).read_bytes() == content


def test_motor_without_a_night_is_refused(fitted_output: Path, tmp_path: Path) -> None:
    fleet = demo_fleet(fitted_output)
    spec = fleet.motors[0]
    strange = replace(spec, file=spec.file.model_copy(update={"motor_id": "CB9"}))
    for one, words in ((fleet, "no motor CB9"), (replace(fleet, motors=(strange,)), "no night of")):
        with pytest.raises(UsageError, match=words):
            write_paper(one, "CB9", tmp_path)
    assert not list(tmp_path.iterdir())
