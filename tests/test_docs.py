"""The walk-through of a fit is run as it stands; the example of a historian's log is a config; the
receiver on the page on trends takes what is sent; the limits on the page on security are the
code's."""

from __future__ import annotations

import base64
import doctest
import json
import re
import sys
import time
import tomllib
from pathlib import Path
from typing import Any

import pytest

from pipeline.config import Alarms
from pipeline.config.channels import Channel
from pipeline.config.logs import Logs
from pipeline.ingest import parquet
from pipeline.ingest.csv import log as csv_log
from pipeline.ingest.csv import text as csv_text
from pipeline.ingest.mcap import layout as mcap_layout
from pipeline.ingest.mcap import ros2 as mcap_ros2
from pipeline.telling.delivery import Delivery
from pipeline.telling.web_hook import WebHook
from tests.pipeline.ingest.fuzzing.judging import CODES
from tests.pipeline.telling.servers import hook

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
    told = (channel.sampling, channel.between, channel.quality_good)
    assert told == ("on_change", "hold", (192,))


def test_the_receiver_on_the_page_on_trends_takes_what_is_sent(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    page = (DOCS / "trends.md").read_text("utf-8").partition("## 10.")[2]
    config = tomllib.loads(page.partition("```toml")[2].partition("```")[0])["alarms"]
    config |= {"command": tuple(config["command"])}
    config["email"] |= {"to": tuple(config["email"]["to"])}
    alarms = Alarms.model_validate(config)
    names: dict[str, Any] = {}
    exec(page.partition("```python")[2].partition("```")[0], names)  # noqa: S102 - our own page
    secret = base64.b64encode(bytes(32)).decode()
    monkeypatch.setenv("HOOK_SECRET", secret)
    monkeypatch.setenv("HOOK_TOKEN", "token")
    content = json.dumps({"changes": [{"id": "a-1"}, {"id": "b-1"}]}).encode()
    with hook() as server:
        receiver = WebHook(server.url(), alarms.webhook_headers, alarms.webhook_secret)
        for _ in range(2):
            receiver.take(Delivery("msg_1", content))
    first, second = server.posts
    assert first.headers["authorization"] == "Bearer token"
    theirs = names["Receiver"](secret)
    assert theirs.changes(first.headers, first.body) == [{"id": "a-1"}, {"id": "b-1"}]
    assert theirs.changes(second.headers, second.body) == []
    with pytest.raises(ValueError, match="not signed"):
        theirs.changes(first.headers, first.body.replace(b"a-1", b"c-1"))
    with pytest.raises(ValueError, match="not signed"):
        names["Receiver"]("AAAB").changes(first.headers, first.body)
    monkeypatch.setattr(time, "time", lambda: int(first.headers["webhook-timestamp"]) + 301)
    with pytest.raises(ValueError, match="too old"):
        theirs.changes(first.headers, first.body)


def test_the_limits_of_the_page_on_security_are_those_of_the_code() -> None:
    page = (DOCS / "security.md").read_text("utf-8")
    text = page.replace(" ", "")
    table = page.partition("## What is bounded")[2].partition("\n\n##")[0]
    gib, mib = 2**30, 2**20
    assert f"{csv_text.LARGEST_TEXT // gib}GiB;from64MiBon{csv_text.LARGEST_RATIO}times" in text
    assert f"{csv_text.LONGEST_LINE // mib}MiB,1MiB,{csv_log.MOST_CELLS}|" in text
    assert parquet.MOST_ROWS == 2**27
    assert f"{parquet.MOST_ROWS_A_BYTE}abyte" in text
    assert f"{parquet.MOST_TEXT_A_ROW}bytesarow" in text
    assert f"{mcap_layout.LARGEST_CHUNK // mib}MiB;{mcap_layout.LONGEST_RECORD // mib}MiB" in text
    assert f"{mcap_ros2.MOST_FIELDS}|" in text
    assert f"{sys.get_int_max_str_digits()},byPython" in text
    assert set(re.findall(r"`(log_\w+)`", table)) <= CODES


def test_the_tests_that_the_page_on_security_names_are_there() -> None:
    page = (DOCS / "security.md").read_text("utf-8")
    there = {path.name for path in (DOCS.parent / "tests").rglob("test_*.py")}
    named = {Path(name).name for name in re.findall(r"`([\w/]*test_\w+\.py)`", page)}
    assert len(named) > 8
    assert named <= there
