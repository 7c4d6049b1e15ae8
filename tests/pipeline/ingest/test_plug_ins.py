"""Readers of installed packages: found by name, and what they do wrong costs their log alone."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from pydantic import ValidationError

from pipeline.config import logs as config_logs
from pipeline.errors import LogError
from pipeline.ingest import read_log, time_span
from pipeline.ingest.conformance import CHANNELS
from tests.pipeline.ingest.sources import logs_of

HEAD = """
import numpy as np
from pipeline.ingest import LogFile, RawChannel, RawLog, Reader, Samples, log_of_samples

def read(file):
    time_us = np.array([1_740_808_800_000_000])
    return log_of_samples(file, {name: Samples(time_us, np.ones(1)) for name in file.channels})

def made(file, value=np.ones(1), time=1_740_808_800_000_000, bad=None, count=0, notes=()):
    one = RawChannel(np.array([time]), value, np.zeros(1, bool), count, bad)
    return RawLog(dict.fromkeys(file.channels, one), count, notes)
"""

Install = Callable[..., None]


@pytest.fixture
def install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Install]:
    """Install packages as pip would: their metadata, and a module each."""
    site = tmp_path / "site-packages"
    site.mkdir()
    monkeypatch.syspath_prepend(str(site))

    def add(package: str, module: str = "", code: str = "", version: str = "1.0") -> None:
        module = module or package
        if code:
            (site / f"{module}.py").write_text(code, "utf-8")
            monkeypatch.delitem(sys.modules, module, raising=False)
        info = site / f"{package.replace('-', '_')}-{version}.dist-info"
        info.mkdir()
        (info / "METADATA").write_text(f"Name: {package}\nVersion: {version}\n", "utf-8")
        entry = f"[{config_logs.GROUP}]\n{package[:4]} = {module}:READER\n"
        (info / "entry_points.txt").write_text(entry, "utf-8")
        config_logs.installed_readers.cache_clear()

    yield add
    config_logs.installed_readers.cache_clear()


def test_a_format_that_nothing_reads_is_a_fault_with_those_that_there_are(install: Install) -> None:
    install("abcd")
    with pytest.raises(ValidationError, match=r"csv, mcap, parquet, .*abcd"):
        logs_of("xlsx")


def test_a_format_of_two_packages_is_a_fault_that_names_both(install: Install) -> None:
    install("mine", "mine", HEAD + "READER = Reader(read)")
    install("mine-too", "mine")
    with pytest.raises(ValidationError, match=r"mine 1\.0 and mine-too 1\.0"):
        logs_of("mine")


def test_a_reader_gets_its_options_and_the_defaults(install: Install, tmp_path: Path) -> None:
    code = "def read(file):\n    raise LogError('log_type', file.path, str(file.logs.options))\n"
    head = "from pipeline.errors import LogError\nfrom pipeline.ingest import Reader\n"
    install("opts", code=head + code + "READER = Reader(read, options={'a': 1, 'b': ''})")
    log = tmp_path / "log"
    log.write_text("x")
    for options, says in (
        ({"b": "x"}, r"\{'a': 1, 'b': 'x'\}"),
        ({"c": 1}, "expected of a = 1, b = ''"),
        ({"a": "x"}, "got a = 'x'"),
    ):
        with pytest.raises(LogError, match=says):
            read_log(log, logs_of("opts", options=options), CHANNELS)
    with pytest.raises(LogError, match="expected of none"):
        read_log(log, logs_of("csv", options={"a": 1}), CHANNELS)


@pytest.mark.parametrize(
    ("code", "says"),
    [
        ("import nowhere", "ModuleNotFoundError"),
        ("READER = 1", "TypeError: no Reader but a int"),
        *(
            (f"def read(file):\n    raise {error}\nREADER = Reader(read)", error[:8])
            for error in ("KeyError('x')", "SystemExit")
        ),
        *(
            (f"READER = Reader(lambda file: {log})", f"{says}")
            for log, says in (
                ("7", "ValueError: gave no RawLog but a int"),
                ("RawLog({}, 0)", "ValueError: gave the channels none"),
                ("RawLog(dict.fromkeys(file.channels), 0)", "AttributeError"),
                ("made(file, np.arange(1))", "ValueError: gave value of pressure_difference as "),
                ("made(file, time=0)", "ValueError: gave time stamps from .* before 1990"),
                ("made(file, time=6 * 10**15)", "ValueError: gave time stamps from .* in the fut"),
                ("made(file, bad=np.zeros(3, bool))", "ValueError: gave bad_quality of pressure"),
                ("made(file, np.ma.ones(1))", "ValueError: gave value of .* as MaskedArray"),
                ("made(file, count='2')", "ValueError: gave rows as '2', not as a count"),
                ("made(file, notes=[])", r"ValueError: gave notes as \[\]"),
            )
        ),
    ],
)
def test_what_a_reader_does_wrong_is_an_error_of_the_log(
    install: Install, tmp_path: Path, code: str, says: str
) -> None:
    install("evil", code=f"{HEAD}\n{code}\n")
    log = tmp_path / "log"
    log.write_text("x")
    for read in (read_log, time_span):
        with pytest.raises(LogError, match=f"reader evil of evil 1.0 failed: {says}") as caught:
            read(log, logs_of("evil"), CHANNELS)
        assert caught.value.code == "log_reader"


def test_what_a_reader_says_of_a_log_is_checked_as_well(
    install: Install, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    code = "print('said')\nREADER = Reader(read, {span})"
    log = tmp_path / "log"
    log.write_text("x")
    for number, (span, says) in enumerate(
        (("lambda file: (3, 2)", "from 3 to 2"), ("lambda file: (0, 1)", "before 1990"))
    ):
        name = f"say{number}"
        install(name, code=HEAD + code.format(span=span))
        with pytest.raises(LogError, match=says):
            time_span(log, logs_of(name), CHANNELS)
    assert capsys.readouterr() == ("", "said\nsaid\n")
