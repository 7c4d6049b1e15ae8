"""The walk-through of a fit is run as it stands; the example of a historian's log is a config."""

from __future__ import annotations

import doctest
import tomllib
from pathlib import Path

from pipeline.config.motors import Channel, Logs

DOCS = Path(__file__).parent.parent / "docs"


def test_the_walk_through_runs_and_prints_what_it_says() -> None:
    found = doctest.testfile(str(DOCS / "fitting.md"), module_relative=False)
    assert found.attempted > 20
    assert found.failed == 0


def test_the_historian_s_log_is_one_that_the_config_takes() -> None:
    page = (DOCS / "historian.md").read_text("utf-8")
    example = tomllib.loads(page.partition("```toml")[2].partition("```")[0])
    tables = {name: tuple(v) if isinstance(v, list) else v for name, v in example["logs"].items()}
    assert Logs.model_validate(tables).layout == "long"
    (keys,) = example["channels"].values()
    channel = Channel.model_validate(keys)
    assert (channel.sampling, channel.between, channel.quality_good) == (
        "on_change",
        "hold",
        (192,),
    )
