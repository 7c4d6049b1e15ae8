"""The conformance kit: what a reader of any format has to do, as checks that need no test runner.

A package that gives a reader runs every check on a `Format`, each in an empty folder::

    @pytest.mark.parametrize("check", checks_of(FORMAT), ids=lambda check: check.__name__)
    def test_conformance(check, tmp_path):
        check(FORMAT, tmp_path)
"""

from __future__ import annotations

from pipeline.ingest.conformance import files, samples
from pipeline.ingest.conformance.formats import (
    CHANNELS,
    STEP_US,
    T0_US,
    Cell,
    Check,
    Format,
    Row,
    many_rows,
    outcome,
    written,
)

__all__ = [
    "CHANNELS",
    "STEP_US",
    "T0_US",
    "Cell",
    "Check",
    "Format",
    "Row",
    "checks_of",
    "many_rows",
    "outcome",
    "written",
]


def checks_of(form: Format) -> tuple[Check, ...]:
    """Checks that apply to a format.

    Each takes the format and an empty folder, and raises an AssertionError, or what the reader
    raised, where the reader does not conform.
    """
    text = _OF_TEXT if form.holds_text else ()
    named = _OF_NAMED_CHANNELS if form.names_channels else ()
    damage = (files.a_flipped_bit_never_raises_anything_else,) if form.survives_damage else ()
    return (*_OF_ALL, *text, *named, *damage)


_OF_ALL: tuple[Check, ...] = (
    samples.every_sample_comes_back_to_the_last_digit,
    samples.a_channel_logged_less_often_is_missing_in_between_or_not_there,
    samples.arrays_have_the_types_of_the_contract_and_cannot_be_written,
    samples.scale_offset_and_unit_make_the_canonical_reading,
    samples.a_reading_too_large_for_another_unit_is_not_finite,
    samples.blank_and_null_are_missing_but_nan_and_infinity_are_readings,
    samples.a_channel_that_is_null_throughout_is_missing_throughout,
    samples.backward_and_repeated_time_stays_in_the_order_of_the_file,
    samples.time_span_is_that_of_the_samples,
    files.a_column_or_topic_that_is_not_there_is_named_with_those_that_are,
    files.stamps_of_a_clock_that_was_never_set_are_left_out_and_noted,
    files.stamps_in_the_future_are_left_out_and_most_of_them_an_error,
    samples.two_readings_are_equal_and_travel_between_processes,
    samples.only_what_is_wanted_is_read,
    samples.one_source_may_feed_two_channels,
    files.what_is_no_log_at_all_is_refused,
    files.random_bytes_are_an_error,
    files.a_cut_file_is_an_error_or_its_whole_rows,
)
_OF_TEXT: tuple[Check, ...] = (
    samples.text_that_is_no_number_is_missing_and_counted,
    samples.a_channel_without_one_number_is_an_error_of_type,
)
_OF_NAMED_CHANNELS: tuple[Check, ...] = (files.a_log_without_rows_has_channels_without_samples,)
