"""Runs deliver changes of state once, try again what failed, and show no secret."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from pipeline.notification import outbox
from tests.pipeline.calling import Call
from tests.pipeline.notification.fleet import keep, told, told_fleet
from tests.pipeline.notification.servers import Hook, hook
from tests.pipeline.run.demo_runs import run


@pytest.fixture(autouse=True)
def _no_waiting(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(outbox, "PAUSES_S", ())


@pytest.fixture
def server() -> Iterator[Hook]:
    with hook() as found:
        yield found


def test_nothing_of_path_query_or_token_is_left_anywhere(
    tmp_path: Path,
    server: Hook,
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
    call: Call,
) -> None:
    monkeypatch.setenv("HOOK_TOKEN", "S3CRET!")
    settings = f'webhook_url = "{server.url("/S3CRET?key=S3CRET")}"\n'
    settings += 'webhook_headers = { Authorization = "Bearer ${HOOK_TOKEN}" }\n'
    config = told_fleet(tmp_path, settings + 'webhook_secret = "${HOOK_TOKEN}"')
    run(config)
    monkeypatch.setenv("HOOK_TOKEN", "S3CRETS3")
    for answer in ((500, ""), (302, server.url("/S3CRET")), (307, "http://S3CRET:1/S3CRET")):
        server.answers["/S3CRET?key=S3CRET"] = answer
        run(config)
    assert [post.headers["authorization"] for post in server.posts] == ["Bearer S3CRETS3"] * 3
    said = caplog.text + "".join(
        call("status", config, *json_too)[1] for json_too in ([], ["--json"])
    )
    assert "S3CRET" not in said
    for path in (tmp_path / "out").rglob("*"):
        assert not path.is_file() or b"S3CRET" not in path.read_bytes()


def test_where_the_state_is_lost_nothing_is_told_again(
    call: Call, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    config = told_fleet(tmp_path, keep(tmp_path / "told"))
    call("fit-fleet", config)
    (delivery,) = told(tmp_path)
    assert delivery["changes"]
    (tmp_path / "out" / "state.db").unlink()
    call("fit-fleet", config)
    assert "state.db is gone" in caplog.text
    assert told(tmp_path) == [delivery]
