"""The ledger: what is written comes back, and a damaged month is left out."""

from __future__ import annotations

import datetime as dt
import hashlib
import os
from dataclasses import replace
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pipeline.errors import StoreError
from pipeline.logs.ledger import (
    FileRecord,
    Ledger,
    NightRecord,
    changed_months,
    content_hash,
    forget_nights,
    ledger_folder,
    month_files,
    read_ledger,
    read_settings,
    settings_file,
)
from pipeline.run.verification import verify_tables
from pipeline.store.sealed import put_sealed, seal

MODELS = st.dictionaries(
    st.sampled_from(["none", "fixed", "estimated"]),
    st.lists(st.floats(allow_nan=False, allow_infinity=False), max_size=5).map(tuple),
)
NIGHTS = st.builds(
    NightRecord,
    st.sampled_from(["ok", "failed", "stood_still"]),
    MODELS,
    statistics_hash=st.sampled_from(["", "0123456789abcdef"]),
)
TEXTS = st.text(st.characters(codec="utf-8"), max_size=20)
RECORDS = st.builds(
    FileRecord,
    path=TEXTS,
    size=st.integers(0, 2**60),
    modified_ns=st.integers(0, 2**63),
    sha256=st.none() | st.just("ab" * 32),
    read_with=st.sampled_from(["", "0123456789abcdef"]),
    rows=st.none() | st.integers(0, 2**40),
    first_us=st.none() | st.integers(-(2**60), 2**60),
    nights=st.lists(st.dates().map(dt.date.isoformat), max_size=3).map(tuple),
    status=st.sampled_from(["ok", "failed"]),
    message=st.none() | TEXTS,
)
LEDGERS = st.builds(
    Ledger,
    st.dictionaries(TEXTS, RECORDS, max_size=3),
    st.dictionaries(st.dates(), NIGHTS, max_size=4),
)
NEW_YEAR = dt.date(2026, 1, 2)
SOME = Ledger(
    {"A/1.csv": FileRecord("A/1.csv", 100, 17, "ab" * 32, "", 5, 1, 2, ("2026-01-02",))},
    {
        NEW_YEAR: NightRecord("ok", {"none": (7.5e-14, 1.56e-14, 4.37e-14, 0.0)}),
        dt.date(2026, 1, 3): NightRecord("stood_still"),
    },
)
TWO_MONTHS = Ledger(
    SOME.files, {**SOME.nights, dt.date(2026, 2, 1): NightRecord("ok", {"none": (1.0, 2.0)})}
)


def write_whole(output: Path, motor_id: str, ledger: Ledger) -> None:
    before = read_ledger(output, motor_id)
    for path, document in month_files(output, motor_id, before, ledger).items():
        put_sealed(path, document)


@given(LEDGERS, LEDGERS)
def test_round_trip(
    tmp_path_factory: pytest.TempPathFactory, first: Ledger, second: Ledger
) -> None:
    """To the last bit: last night's model is part of tonight's figures."""
    output = tmp_path_factory.mktemp("ledger")
    for ledger in (first, second):
        write_whole(output, "A", ledger)
        assert read_ledger(output, "A") == ledger


def test_same_ledger_same_bytes(tmp_path: Path) -> None:
    backwards = Ledger(SOME.files, dict(reversed(list(SOME.nights.items()))))
    for motor, ledger in (("A", SOME), ("B", backwards)):
        write_whole(tmp_path, motor, ledger)
    assert [
        (ledger_folder(tmp_path, motor) / "2026-01.json").read_bytes() for motor in "AB"
    ] == 2 * [(ledger_folder(tmp_path, "A") / "2026-01.json").read_bytes()]


def test_each_motor_and_month_has_its_own_file(tmp_path: Path) -> None:
    write_whole(tmp_path, "A", TWO_MONTHS)
    assert read_ledger(tmp_path, "B") == Ledger()
    files = {path.relative_to(tmp_path).as_posix() for path in tmp_path.rglob("*.json")}
    assert files == {"ledger/A/2026-01.json", "ledger/A/2026-02.json"}


def test_only_months_that_changed_are_written() -> None:
    later = {**TWO_MONTHS.nights, dt.date(2026, 2, 2): NightRecord("failed")}
    changed = changed_months(TWO_MONTHS, Ledger(TWO_MONTHS.files, later))
    assert list(changed) == ["2026-02"]
    assert not changed_months(TWO_MONTHS, TWO_MONTHS)
    assert changed_months(SOME, Ledger()) == {"2026-01": Ledger()}


def test_a_file_moves_with_its_first_night(tmp_path: Path) -> None:
    write_whole(tmp_path, "A", SOME)
    moved = replace(SOME.files["A/1.csv"], nights=("2026-03-01",))
    after = Ledger({"A/1.csv": moved}, SOME.nights)
    write_whole(tmp_path, "A", after)
    assert read_ledger(tmp_path, "A") == after


def test_none_there(tmp_path: Path) -> None:
    assert read_ledger(tmp_path, "A") == Ledger()


def test_a_forgotten_night_is_forgotten_with_its_files(tmp_path: Path) -> None:
    for motor in "AB":
        write_whole(tmp_path, motor, TWO_MONTHS)
    third = dt.date(2026, 1, 3)
    assert forget_nights(tmp_path, {NEW_YEAR, third}, {"B"}) == {"A": {NEW_YEAR}}
    # The night after is still judged with the model of one whose log may be gone.
    kept = {night: one for night, one in TWO_MONTHS.nights.items() if night != third}
    assert read_ledger(tmp_path, "A") == Ledger({}, kept)
    assert read_ledger(tmp_path, "B") == TWO_MONTHS


def test_a_forgotten_night_can_be_fitted_anew_from_its_statistics(tmp_path: Path) -> None:
    made = replace(SOME.nights[NEW_YEAR], figures_hash="0123456789abcdef")
    write_whole(tmp_path, "A", Ledger(SOME.files, {NEW_YEAR: made}))
    forget_nights(tmp_path, {NEW_YEAR}, refit={NEW_YEAR})
    expected = replace(made, figures_hash="")
    assert read_ledger(tmp_path, "A") == Ledger({}, {NEW_YEAR: expected})


class TestDamage:
    @pytest.fixture
    def file(self, tmp_path: Path) -> Path:
        write_whole(tmp_path, "A", SOME)
        return ledger_folder(tmp_path, "A") / "2026-01.json"

    @pytest.mark.parametrize(
        "content",
        [
            b"",
            b"null",
            seal({}),
            seal({"files": [], "nights": {}}),
            seal({"files": {"a": 1}, "nights": {}}),
            seal({"files": {}, "nights": {"soon": {}}}),
        ],
        ids=lambda content: content[:20].decode(errors="replace"),
    )
    def test_something_else(self, tmp_path: Path, file: Path, content: bytes) -> None:
        file.write_bytes(content)
        assert read_ledger(tmp_path, "A") == Ledger()

    def test_a_damaged_month_costs_no_other(self, tmp_path: Path, file: Path) -> None:
        write_whole(tmp_path, "A", TWO_MONTHS)
        file.write_bytes(b"{")
        february = dt.date(2026, 2, 1)
        expected = Ledger({}, {february: TWO_MONTHS.nights[february]})
        assert read_ledger(tmp_path, "A") == expected

    def test_another_digit_of_a_model(self, tmp_path: Path, file: Path) -> None:
        """It would show in tonight's figures."""
        content = file.read_bytes()
        assert b"7.5e-14" in content
        file.write_bytes(content.replace(b"7.5e-14", b"7.4e-14"))
        assert read_ledger(tmp_path, "A") == Ledger()

    def test_folder_in_its_place(self, tmp_path: Path) -> None:
        (ledger_folder(tmp_path, "A") / "2026-01.json").mkdir(parents=True)
        assert read_ledger(tmp_path, "A") == Ledger()
        with pytest.raises(StoreError):
            write_whole(tmp_path, "A", SOME)

    def test_failed_write_leaves_the_old_one(
        self, tmp_path: Path, file: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        def fail(*_: object) -> None:
            raise OSError(28, "No space left on device")

        monkeypatch.setattr(os, "replace", fail)
        with pytest.raises(StoreError):
            write_whole(tmp_path, "A", Ledger())
        assert read_ledger(tmp_path, "A") == SOME
        assert [path.name for path in file.parent.iterdir()] == [file.name]


def test_damaged_settings_are_seen_and_written_anew(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    settings = {"reference.speed_rpm": "30.0", "cleaning.hampel_window": "11"}
    put_sealed(settings_file(tmp_path, "A"), settings)
    assert read_settings(tmp_path, "A") == settings
    path = settings_file(tmp_path, "A")
    whole = path.read_bytes()
    path.write_bytes(whole.replace(b"30.0", b"31.0"))
    assert read_settings(tmp_path, "A") == {}
    assert "ledger/A/settings is damaged" in caplog.text
    assert [fault.code for fault in verify_tables(tmp_path)] == ["ledger_damaged"]
    put_sealed(settings_file(tmp_path, "A"), settings)
    assert path.read_bytes() == whole


@pytest.mark.parametrize(
    ("fitted", "without", "day", "found"),
    [
        ([5], [], 5, None),
        ([3], [4, 5], 6, 3),
        ([3, 9], [], 5, 3),
        ([4, 2, 3], [], 8, 4),
        ([], [], 1, None),
        ([3], [], 3, None),
    ],
)
def test_the_model_before_is_that_of_the_last_fitted_night(
    fitted: list[int], without: list[int], day: int, found: int | None
) -> None:
    """Not the night's own, nor a later one's, whatever their order."""
    models = {one: {"none": (float(one),)} for one in fitted}
    nights = {one: NightRecord("ok", models.get(one, {})) for one in (*fitted, *without)}
    ledger = Ledger(nights={dt.date(2026, 1, one): record for one, record in nights.items()})
    expected = {} if found is None else models[found]
    assert ledger.model_before(dt.date(2026, 1, day)) == expected


@settings(max_examples=20)
@given(st.binary(max_size=100))
def test_content_hash(tmp_path_factory: pytest.TempPathFactory, content: bytes) -> None:
    path = tmp_path_factory.mktemp("hash") / "log"
    path.write_bytes(content)
    assert content_hash(path) == hashlib.sha256(content).hexdigest()


def test_content_hash_of_what_cannot_be_read(tmp_path: Path) -> None:
    for path in (tmp_path, tmp_path / "absent"):
        with pytest.raises((FileNotFoundError, IsADirectoryError)):
            content_hash(path)
