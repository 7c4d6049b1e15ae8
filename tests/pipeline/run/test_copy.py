"""A fleet whose logs lie at a URL, and whose tables are copied to one, by the command."""

from __future__ import annotations

import datetime as dt
import hashlib
import json
import os
import shutil
from pathlib import Path
from typing import Any

import duckdb
import polars as pl
import pytest

from tests.pipeline.calling import (
    FIRST,
    Call,
    change,
    contents,
    table_files,
)
from tests.pipeline.s3_server import BUCKET, URL, Request, Server, Stored, never, upload
from tests.pipeline.workshop import DAY, QUICK, Workshop

LOGS = f"s3://{BUCKET}/logs"
MANIFEST = "manifest.json"
FEBRUARY = dt.date(2026, 2, 1)


@pytest.fixture
def shop(tmp_path: Path) -> Workshop:
    """A motor with one night that is not fitted yet; its tables are copied to a URL."""
    made = Workshop.at(tmp_path)
    made.configure(fleet=QUICK.replace("[folders]\n", f'[folders]\ncopy_to = "{URL}"\n'))
    made.log(FIRST)
    return made


def published(output: Path) -> dict[str, bytes]:
    """Table files of an output folder, by path, and the manifest of their copy."""
    files = dict(sorted(contents(output / "tables").items()))
    digests = {name: hashlib.sha256(content).hexdigest() for name, content in files.items()}
    manifest = json.dumps({"sha256": digests}, indent=0).encode()
    return {f"tables/{name}": content for name, content in files.items()} | {MANIFEST: manifest}


def put_keys(server: Server) -> list[str]:
    """Keys that were put, in order."""
    return [path.removeprefix(f"/{BUCKET}/fleet/") for path in server.asked("PUT")]


def test_logs_and_copy_at_a_url_give_the_tables_of_folders(
    server: Server, shop: Workshop, tmp_path: Path, call: Call
) -> None:
    # A private run is copied nowhere.
    assert call("fit-fleet", shop.fleet, "--output", tmp_path / "folder")[0] == 0
    assert server.below(URL) == {}
    upload(tmp_path / "logs", LOGS)
    shutil.rmtree(tmp_path / "logs")
    change(shop.fleet, "fleet.toml", 'logs = "../logs"', f'logs = "{LOGS}"')
    assert call("fit-fleet", shop.fleet)[0] == 0
    assert table_files(shop.output) == table_files(tmp_path / "folder")
    assert server.below(URL) == published(shop.output)
    # The second run opens no log.
    server.forget()
    assert "1 motor" in call("fit-fleet", shop.fleet)[1]
    assert not [path for path in server.asked("GET") if path.startswith(f"/{BUCKET}/logs/")]
    assert not [key for key in put_keys(server) if "month=2026-01" in key]


def test_a_second_run_copies_what_changed_and_removes_what_went(
    server: Server, shop: Workshop, call: Call
) -> None:
    assert call("fit-fleet", shop.fleet)[0] == 0
    before = server.below(URL)
    assert before == published(shop.output)
    assert put_keys(server)[-1] == MANIFEST
    shop.log(FEBRUARY)
    server.forget()
    assert call("fit-fleet", shop.fleet)[0] == 0
    after = server.below(URL)
    assert after == published(shop.output)
    assert sorted(put_keys(server)) == [key for key in after if after[key] != before.get(key)]
    assert put_keys(server)[-1] == MANIFEST
    assert call("prune", shop.fleet, "--tables", "predictions", "--keep", "1", "--yes")[0] == 0
    server.forget()
    assert call("fit-fleet", shop.fleet)[0] == 0
    assert server.below(URL) == published(shop.output)
    last, removal = [request for request in server.requests if request.method != "GET"][-2:]
    assert last == Request("PUT", f"/{BUCKET}/fleet/{MANIFEST}")
    assert removal.method == "POST"
    assert after.keys() - server.below(URL).keys() == {
        f"tables/predictions/month=2026-01/{FIRST}.parquet"
    }


def test_what_the_store_refuses_the_next_run_copies(
    server: Server, shop: Workshop, call: Call
) -> None:
    """Also where a log, and with it every table, is again as it was before."""
    assert call("fit-fleet", shop.fleet)[0] == 0
    original = shop.logs / f"{FIRST}.parquet"
    content, manifest = original.read_bytes(), server.below(URL)[MANIFEST]
    shop.log(FIRST, seed=2)
    server.fails = lambda asked: asked.method == "PUT" and asked.path.endswith(MANIFEST)
    code, out, _ = call("fit-fleet", shop.fleet, "--json")
    (event,) = (json.loads(line) for line in out.splitlines() if '"event": "run"' in line)
    assert (code, event["n_failed"], event["n_nights"]) == (1, 0, 1)
    assert event["copy_fault"].startswith("store_write: ")
    assert server.below(URL)[MANIFEST] == manifest
    # The local run is whole: what failed is the copy.
    assert call("check", shop.fleet, "--tables")[0] == 0
    server.fails = lambda asked: asked.method == "PUT"
    code, _, err = call("fit-fleet", shop.fleet)
    assert code == 1
    assert f"not copied to {URL}: store_write: " in err
    server.fails = never
    original.write_bytes(content)
    assert call("fit-fleet", shop.fleet)[0] == 0
    assert server.below(URL) == published(shop.output)
    # What somebody has removed or spoilt there is copied again.
    del server.objects["fleet/tables/fits/month=2026-01/2026-01.parquet"]
    assert call("fit-fleet", shop.fleet)[0] == 0
    assert server.below(URL) == published(shop.output)
    server.objects[f"fleet/{MANIFEST}"] = Stored(b"no JSON", 0)
    assert call("fit-fleet", shop.fleet)[0] == 0
    assert server.below(URL) == published(shop.output)


def test_a_file_that_rots_on_the_disk_is_not_copied(
    server: Server, shop: Workshop, call: Call
) -> None:
    assert call("fit-fleet", shop.fleet)[0] == 0
    fits = shop.output / "tables" / "fits" / "month=2026-01" / "2026-01.parquet"
    content, stat = bytearray(fits.read_bytes()), fits.stat()
    content[100] ^= 1
    fits.write_bytes(content)
    os.utime(fits, ns=(stat.st_atime_ns, stat.st_mtime_ns))
    del server.objects["fleet/tables/fits/month=2026-01/2026-01.parquet"]
    code, _, err = call("fit-fleet", shop.fleet)
    assert code == 1
    assert "2026-01.parquet is not what was published" in err


def test_readers_of_the_copy_need_no_list_of_files(
    server: Server, shop: Workshop, call: Call, tmp_path: Path
) -> None:
    """The examples of `docs/scale.md`: Polars at the URL, DuckDB on a copy of the bucket."""
    shop.log(FIRST + DAY)
    assert call("fit-fleet", shop.fleet)[0] == 0
    names: dict[str, Any] = {}
    exec(block_of_scale("python", "nights = ", URL), names)  # noqa: S102 - our own page
    nights: pl.DataFrame = names["nights"]
    assert sorted(nights["night"].to_list()) == [FIRST, FIRST + DAY]
    for path, content in server.below(URL).items():
        place = tmp_path / "bucket" / path
        place.parent.mkdir(parents=True, exist_ok=True)
        place.write_bytes(content)
    with duckdb.connect() as connection:
        query = block_of_scale("sql", "read_parquet", str(tmp_path / "bucket"))
        rows = connection.execute(query).fetchall()
    assert rows == [("M1", FIRST, "ok"), ("M1", FIRST + DAY, "ok")]
    digests = json.loads(server.below(URL)[MANIFEST])["sha256"]
    for name, digest in digests.items():
        assert hashlib.sha256(server.below(URL)[f"tables/{name}"]).hexdigest() == digest


def block_of_scale(language: str, word: str, root: str) -> str:
    """An example of `scale.md`, of a bucket elsewhere."""
    page = (Path(__file__).parents[3] / "docs" / "scale.md").read_text("utf-8")
    blocks = [part.partition("```")[0] for part in page.split(f"```{language}\n")[1:]]
    (block,) = (block for block in blocks if word in block)
    return block.replace("s3://bucket/fleet", root)
