"""Tables of what was read and done: files, runs, motors in a run; and the data dictionary."""

from __future__ import annotations

import polars as pl

from pipeline.schema.columns import (
    MOTOR_ID,
    NAMES,
    RUN_ID,
    TIMESTAMP,
    Column,
    Table,
)

INPUT_FILES = Table(
    "input_files",
    "a file read",
    ("motor_id", "path"),
    (
        MOTOR_ID,
        Column("path", pl.String, "", "Relative to the log root"),
        Column(
            "night",
            pl.Date,
            "",
            "First night of the file; null where one that cannot be read is of none: its row "
            "stands among those of the motor's first night",
        ),
        Column("format", pl.String, "", "csv, parquet or mcap"),
        Column("size_bytes", pl.Int64, "B", "Size"),
        Column("sha256", pl.String, "", "Hash of the content; null where it could not be read"),
        Column("rows", pl.Int64, "", "Rows or messages"),
        Column("first_time", TIMESTAMP, "UTC", "First sample"),
        Column("last_time", TIMESTAMP, "UTC", "Last sample"),
        Column("status", pl.String, "", "ok or failed"),
        Column("error_code", pl.String, "", "Stable code of the failure"),
        Column("message", pl.String, "", "The failure, or what was left out, in words"),
        RUN_ID,
    ),
)

RUNS = Table(
    "runs",
    "a run",
    ("run_id", "started_at"),
    (
        RUN_ID,
        Column("started_at", TIMESTAMP, "UTC", "Start of the run"),
        Column("finished_at", TIMESTAMP, "UTC", "End of the run"),
        Column("status", pl.String, "", "ok, motors_failed or interrupted"),
        Column("fleet", pl.String, "", "Name of the fleet"),
        Column("version", pl.String, "", "Version of motor-leakage"),
        Column("schema_version", pl.Int64, "", "Version of the tables"),
        Column("config_hash", pl.String, "", "Hash of all settings that shape figures"),
        Column("seed", pl.Int64, "", "Seed of the run"),
        Column("workers", pl.Int64, "", "Motors fitted at the same time"),
        Column("n_motors", pl.Int64, "", "Motors in the run"),
        Column("n_motors_failed", pl.Int64, "", "Motors with at least one failed night"),
        Column("n_nights", pl.Int64, "", "Nights of motors that were written"),
        Column("seconds", pl.Float64, "s", "Wall-clock time"),
        Column("motors_s", pl.Float64, "s", "Of it: until the tasks of all motors were done"),
        Column("publish_s", pl.Float64, "s", "Of it: publishing what they had staged"),
        Column("trends_s", pl.Float64, "s", "Of it: making and publishing trends"),
        *(
            Column(f"{name}_version", pl.String, "", f"Version of {words}")
            for name, words in (
                ("python", "Python"),
                ("polars", "Polars"),
                ("pyarrow", "PyArrow"),
                ("numpy", "NumPy"),
                ("scipy", "SciPy"),
            )
        ),
        Column(
            "damage",
            NAMES,
            "",
            "Published files that the run found damaged or gone, in words, each with its code",
        ),
    ),
)

MOTOR_OUTCOMES = Table(
    "motor_outcomes",
    "a motor in a run",
    ("run_id", "started_at", "motor_id"),
    (
        RUN_ID,
        Column("started_at", TIMESTAMP, "UTC", "Start of the run"),
        MOTOR_ID,
        Column(
            "status",
            pl.String,
            "",
            "failed if a night failed; else ok if a night was fitted; else what came of its nights",
        ),
        Column("error_code", pl.String, "", "Code of the first failure"),
        Column(
            "message",
            pl.String,
            "",
            "The first failure in words, with its file or night; without a failure, why nothing "
            "could be fitted, or null; and which nights were withdrawn, as no log has samples of "
            "them",
        ),
        Column("n_ok", pl.Int64, "", "Nights with a fit"),
        Column("n_stood_still", pl.Int64, "", "Nights in which the motor stood still"),
        Column("n_insufficient_data", pl.Int64, "", "Nights with too little to fit"),
        Column("n_no_new_data", pl.Int64, "", "Nights without a log"),
        Column("n_failed", pl.Int64, "", "Nights that failed"),
        Column("read_s", pl.Float64, "s", "Seconds for finding, hashing and reading logs"),
        Column("clean_s", pl.Float64, "s", "Seconds for cleaning and the time base"),
        Column("statistics_s", pl.Float64, "s", "Seconds for regressors and blocks"),
        Column(
            "fit_s",
            pl.Float64,
            "s",
            "Seconds for certificate, search and validation; before version 4 residuals too",
        ),
        Column("store_s", pl.Float64, "s", "Seconds for staging the rows"),
        Column("peak_memory_mib", pl.Float64, "MiB", "Largest memory of the worker so far"),
        Column("n_refitted", pl.Int64, "", "Nights fitted anew from statistics, without a log"),
        Column("refit_s", pl.Float64, "s", "Seconds for that"),
        Column("growing", NAMES, "", "Log files that were changed while they were read, in words"),
        Column("n_files_read", pl.Int64, "", "Log files that were read"),
        Column("n_files_unchanged", pl.Int64, "", "Log files done by a run before, and not read"),
        Column(
            "n_files_growing",
            pl.Int64,
            "",
            "Log files that were changed while they were read: left to the next run, and with them "
            "their nights",
        ),
        Column("n_files_failed", pl.Int64, "", "Log files that cannot be read"),
        Column(
            "n_files_left",
            pl.Int64,
            "",
            "New log files of nights that were not asked for, or that wait for a growing file",
        ),
        Column("residuals_s", pl.Float64, "s", "Seconds for the tests of residuals"),
    ),
)

DATA_DICTIONARY = Table(
    "data_dictionary",
    "a column of a table",
    ("table", "column"),
    (
        Column("table", pl.String, "", "The table"),
        Column("column", pl.String, "", "The column"),
        Column("type", pl.String, "", "Type, as Polars names it"),
        Column("unit", pl.String, "", "Unit; empty for none"),
        Column("description", pl.String, "", "Meaning"),
        Column("in_key", pl.Boolean, "", "Whether the column is part of the table's key"),
        Column("schema_version", pl.Int64, "", "Version of the tables"),
    ),
)
