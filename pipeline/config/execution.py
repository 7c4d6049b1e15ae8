"""Settings of the fleet alone: its folders, how a run is done, what is kept and measured."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated, Literal

from pydantic import Field

from pipeline.config.faults import Misfit
from pipeline.config.section import NonNegative, Positive, Section, Stage

RelativeFolder = Annotated[str, Field(min_length=1)]


class Folders(Section):
    """Folders; each is relative to the fleet file."""

    shapes = Stage.NOTHING

    motors: RelativeFolder = "motors"
    """Folder of the motors' files, one per motor."""
    motor_types: RelativeFolder = "motor_types"
    """Folder of the motor types."""
    oils: RelativeFolder = "oils"
    """Folder of the oils."""
    oil_circuits: RelativeFolder = "oil_circuits"
    """Folder of the oil circuits; it may be absent."""
    logs: RelativeFolder = "../logs"
    """Root of the logs, a folder or a URL such as s3://bucket/logs; the paths in `input_files` are
    relative to it."""
    output: RelativeFolder | None = None
    """Output folder, which holds no logs; default: `out/` in the working directory."""
    object_store: str = Field("", pattern=r"^$|^(s3|az|gs)://[^/\s]+(/\S*)?$")
    """Where the output is published, such as s3://bucket/fleet (or az://, gs://); the output folder
    is then its working copy (`scale.md`); empty: the folder is all."""


class Execution(Section):
    """Execution of a run; nothing here changes a figure."""

    shapes = Stage.NOTHING

    workers: int = Field(2, ge=1, le=256)
    """Motors fitted at the same time."""
    backend: Literal["loky", "sequential", "dask"] = "loky"
    """`loky`: worker processes of this machine, also with `workers` = 1 (joblib starts them);
    `sequential`: one after the other in the run's own process, without limits: a motor that hangs
    or crashes stops the run; `dask`: a Dask cluster (`scale.md`)."""
    scheduler: str = Field("", pattern=r"^$|^(tcp|tls)://[^/\s]+:[0-9]+$")
    """`dask`: address of the scheduler, such as tcp://10.0.0.5:8786."""
    tasks_in_flight: int = Field(256, ge=1)
    """`dask`: most tasks at the scheduler at a time."""
    scheduler_wait_s: Positive = 30.0
    """`dask`: time to wait for the scheduler, and for its first worker."""
    timeout_s: Positive = Field(600.0, le=604_800.0)
    """Longest time for one night of a motor, or for the trends of a group of motors; then the
    worker is ended [s]."""
    answer_s: Positive = Field(60.0, le=604_800.0)
    """A log that does not answer for this long when it is opened fails (`log_no_answer`) [s]."""
    memory_limit_mib: int = Field(4096, ge=512, le=1_048_576)
    """Most memory that a worker of this machine may ask for, 400 of it for the program itself
    (RLIMIT_DATA; enforced on Linux) [MiB]."""
    minimum_free_mib: NonNegative = 100.0
    """Free disk space that a run requires beyond its own tables [MiB]; 0: not checked."""
    prove_within_days: int = Field(30, ge=1, le=365)
    """Days within which every published file is read and compared with its SHA-256, a share in
    each run [days]."""

    def misfits(self) -> Iterator[Misfit]:
        """A cluster without an address."""
        if self.backend == "dask" and not self.scheduler:
            yield ("scheduler",), "is missing: the address of the Dask scheduler", None


class Retention(Section):
    """Newest nights whose rows `prune` keeps, by table; without a number all are kept."""

    shapes = Stage.NOTHING

    predictions: int | None = Field(None, ge=1)
    """Nights kept of `predictions`."""
    starts: int | None = Field(None, ge=1)
    """Nights kept of `starts`."""
    residual_tests: int | None = Field(None, ge=1)
    """Nights kept of `residual_tests`."""
    sensitivities: int | None = Field(None, ge=1)
    """Nights kept of `sensitivities`."""


class Metrics(Section):
    """Metrics of each run as a file for Prometheus."""

    shapes = Stage.NOTHING

    textfile: str = Field("", pattern=r"^$|\.prom$")
    """File below the folder of the node exporter's textfile collector, such as
    `/var/lib/prometheus/node-exporter/motor-leakage.prom`; relative to the fleet file; empty: none
    is written."""
