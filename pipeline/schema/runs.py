"""Tables of what was read and done: files, runs, motors in a run; and the data dictionary."""

from __future__ import annotations

import polars as pl

from pipeline.schema.columns import (
    MOTOR_ID,
    NAMES,
    RUN_ID,
    Column,
    Table,
    count,
    day,
    flag,
    moment,
    number,
    text,
)

INPUT_FILES = Table(
    "input_files",
    "a file read",
    ("motor_id", "path"),
    (
        MOTOR_ID,
        text("path", "Relative to the log root"),
        day(
            "night",
            "First night of the file; null where one that cannot be read is of none: its row "
            "stands among those of the motor's first night",
        ),
        text("format", "csv, parquet or mcap"),
        Column("size_bytes", pl.Int64, "B", "Size"),
        text("sha256", "Hash of the content; null where it could not be read"),
        count("rows", "Rows or messages"),
        moment("first_time", "First sample"),
        moment("last_time", "Last sample"),
        text("status", "ok or failed"),
        text("error_code", "Stable code of the failure"),
        text("message", "The failure, or what was left out, in words"),
        RUN_ID,
    ),
)

RUNS = Table(
    "runs",
    "a run",
    ("run_id", "started_at"),
    (
        RUN_ID,
        moment("started_at", "Start of the run"),
        moment("finished_at", "End of the run"),
        text("status", "ok, motors_failed or interrupted"),
        text("fleet", "Name of the fleet"),
        text("version", "Version of motor-leakage"),
        count("schema_version", "Version of the tables"),
        text("config_hash", "Hash of all settings that shape figures"),
        count("seed", "Seed of the run"),
        count("workers", "Motors fitted at the same time"),
        count("n_motors", "Motors in the run"),
        count("n_motors_failed", "Motors with at least one failed night"),
        count("n_nights", "Nights of motors that were written"),
        number("seconds", "s", "Wall-clock time"),
        number("motors_s", "s", "Of it: until the tasks of all motors were done"),
        number("publish_s", "s", "Of it: publishing what they had staged"),
        number("trends_s", "s", "Of it: making and publishing trends"),
        *(
            text(f"{name}_version", f"Version of {words}")
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
        moment("started_at", "Start of the run"),
        MOTOR_ID,
        text(
            "status",
            "failed if a night failed; else ok if a night was fitted; else what came of its nights",
        ),
        text("error_code", "Code of the first failure"),
        text(
            "message",
            "The first failure in words, with its file or night; without a failure, why nothing "
            "could be fitted, or null; and which nights were withdrawn, as no log has samples of "
            "them",
        ),
        count("n_ok", "Nights with a fit"),
        count("n_stood_still", "Nights in which the motor stood still"),
        count("n_insufficient_data", "Nights with too little to fit"),
        count("n_no_new_data", "Nights without a log"),
        count("n_failed", "Nights that failed"),
        number("read_s", "s", "Seconds for finding, hashing and reading logs"),
        number("clean_s", "s", "Seconds for cleaning and the time base"),
        number("statistics_s", "s", "Seconds for regressors and blocks"),
        number(
            "fit_s",
            "s",
            "Seconds for certificate, search and validation; before version 4 residuals too",
        ),
        number("store_s", "s", "Seconds for staging the rows"),
        number("peak_memory_mib", "MiB", "Largest memory of the worker so far"),
        count("n_refitted", "Nights fitted anew from statistics, without a log"),
        number("refit_s", "s", "Seconds for that"),
        Column("growing", NAMES, "", "Log files that were changed while they were read, in words"),
        count("n_files_read", "Log files that were read"),
        count("n_files_unchanged", "Log files done by a run before, and not read"),
        count(
            "n_files_growing",
            "Log files that were changed while they were read: left to the next run, and with them "
            "their nights",
        ),
        count("n_files_failed", "Log files that cannot be read"),
        count(
            "n_files_left",
            "New log files of nights that were not asked for, or that wait for a growing file",
        ),
        number("residuals_s", "s", "Seconds for the tests of residuals"),
    ),
)

DATA_DICTIONARY = Table(
    "data_dictionary",
    "a column of a table",
    ("table", "column"),
    (
        text("table", "The table"),
        text("column", "The column"),
        text("type", "Type, as Polars names it"),
        text("unit", "Unit; empty for none"),
        text("description", "Meaning"),
        flag("in_key", "Whether the column is part of the table's key"),
        count("schema_version", "Version of the tables"),
    ),
)
