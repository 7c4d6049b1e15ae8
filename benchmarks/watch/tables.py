"""Tables of outcomes: a row of each motor, which come together by cell, or as named."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import polars as pl
from scipy.special import gammaincinv

from benchmarks.watch.cells import BASELINE, YEAR, Cell, Event
from benchmarks.watch.outcomes import Outcome
from benchmarks.watch.simulator import PATHS
from validation.tables import Table

SOON = 3  # nights within which a wear that has reached 8 % is to be detected, the first being 1
PARTS = {*PATHS, "known"}  # what a change may be called that names a part
Nights = Sequence[int | None]
# Of what not every motor has.
RIGHTS = ("right", "less than right", "right later", "less than right later")
TYPES = {
    **dict.fromkeys(("cause", "verdict", "size", "P", "P later"), pl.String),
    **dict.fromkeys(("since held", "size held", *RIGHTS), pl.Boolean),
    "night": pl.Int64,
    "leakages": pl.List(pl.List(pl.Float64)),
}


def tables(cells: Mapping[str, Cell], outcomes: Mapping[str, Any]) -> list[Table]:
    """Return the tables of all outcomes."""
    motors, made = _motors(cells, outcomes), []
    for name, (groups, header, rows, keys) in TABLES.items():
        of = motors.filter(pl.any_horizontal(pl.col("group").str.starts_with(g) for g in groups))
        by = rows(of).group_by(keys, maintain_order=True)
        columns = header.split(" | ")
        made.append(
            Table(name, [{column: _text(of, column) for column in columns} for _, of in by])
        )
    return made


def readme(cells: Mapping[str, Cell], outcomes: Mapping[str, Any]) -> Table:
    """Return the README's table, of the cells that were measured."""
    header = ("", "watch", *README_CHARTS)
    keys = {words: f"{key}; otherwise; {BASELINE}" for words, key in README_ROWS.items()}
    rows = [
        [words, *_readme_row(_motors(cells, {key: outcomes[key]}))]
        for words, key in keys.items()
        if key in outcomes
    ]
    return Table("watch", [dict(zip(header, row, strict=True)) for row in rows])


def _motors(cells: Mapping[str, Cell], outcomes: Mapping[str, Any]) -> pl.DataFrame:
    """Return a row of each motor, in order of the cells."""
    known = [(cell, outcomes[key]) for key, cell in cells.items() if key in outcomes]
    rows = [_row(cell, motor) for cell, motors in known for motor in motors]
    return pl.DataFrame(rows, schema_overrides=TYPES, infer_schema_length=None)


def _row(cell: Cell, motor: Outcome) -> dict[str, Any]:
    event, reported = cell.event, motor["reported"]
    since, reached = max(cell.baseline, event.begin or 0), motor["reached"]
    # What was detected as an alarm and was not reported before.
    alarms = [of["night"] for of in reported if not (of["is_notice"] or of["continues"])]
    # Detected first of the change, or since the baseline: an alarm, or a notice that is right; the
    # same again, where it was detected before the change.
    hits = (of for of in reported if not of["is_notice"] or of["first"][0] in event.right)
    first = next((hit for hit in hits if hit["night"] >= since), None)
    end = event.nights if event.begin is None else since
    named = " and ".join(of[when][0] for of in reported for when in ("first", "cause"))
    return dict.fromkeys(TYPES) | {
        "group": cell.group,
        "change": cell.words,
        "machine": cell.machine,
        "baseline": str(cell.baseline),
        "begin": event.begin,
        "kind": _kind(event),
        "left": event.nights - (event.begin or 0),
        "watched": event.nights - cell.baseline,
        # Alarms before anything is otherwise.
        "false alarms": sum(night < end for night in alarms),
        "false": any(night < end for night in alarms),
        "notices": sum(of["is_notice"] for of in reported),
        "part named": not PARTS.isdisjoint(named.split(" and ")),
        "lack of fit": motor["lack"],
        "reported": first is not None,
        "soon": reached and bool(first and first["night"] < reached + SOON),
        **{name: motor.get(name) for name in ("tonight", "rivals", "leakages")},
        **(_first(event, first) if first else {}),
        "behind": event.nights - first["night"] if first else 0,
        "more": sum(night > first["night"] for night in alarms) if first else 0,
    }


def _first(event: Event, of: Outcome) -> dict[str, Any]:
    """Return what there is of the change that was reported first."""
    (cause, *_), (lower, _, upper), size = of["cause"], of["since"], of["size"]
    is_change = event.begin is not None
    # Nothing has a size where nothing changes; odd nights are no change that stays.
    is_sized = is_change and cause != "odd_nights"
    is_near = cause == "not_identified" or cause in event.near
    return {
        "night": of["night"] - (event.begin or 0) + 1,  # the change's first being 1
        "cause": cause,
        "verdict": "right" if cause in event.right else "cannot" if is_near else "wrong",
        "since held": lower <= event.begin <= upper if is_change else None,
        "size held": size[1] <= of["true"] <= size[2] if is_sized else None,
        "size": "{:+.1f} ({:+.1f} to {:+.1f}) %".format(*np.multiply(100.0, size)),
        **_likeliest(event, of["first"], ""),
        **_likeliest(event, of["cause"], " later"),
    }


def _likeliest(event: Event, names: Sequence[Any], when: str) -> dict[str, Any]:
    _, cause, probability = names
    tenth = min(int(10 * probability), 9)
    return {
        f"P{when}": f"{tenth / 10:.1f} to {(tenth + 1) / 10:.1f}",
        f"right{when}": cause in event.right,
        f"less than right{when}": cause in event.near,
    }


def _kind(event: Event) -> str | None:
    """How something that has a name changes."""
    if event.begin is None or not (event.right or event.near):
        return None
    return "step" if event.is_step else "ramp" if event.begin else "ramp from the first night"


def _text(motors: pl.DataFrame, name: str) -> str:
    """A column of some motors: what they share, a count, a mean, how many of all."""
    if column := COLUMNS.get(name):
        return column(motors)
    values = motors[name].drop_nulls()
    if values.dtype == pl.Boolean:
        n, count = len(values), values.sum()
        return f"{count} of {n} ({100 * count / n:.0f} %)" if n else "–"
    if values.dtype == pl.Float64:
        return f"{100 * values.to_numpy().mean():.1f} %"
    return str(values.sum()) if values.dtype.is_integer() else next(iter(values), "–")


def _names(motors: pl.DataFrame) -> str:
    """Return how many names are right / cannot be identified / wrong, and the wrong ones."""
    counted = Counter(motors["verdict"])
    wrong = Counter(motors.filter(verdict="wrong")["cause"])
    counts = "/".join(str(counted[verdict]) for verdict in ("right", "cannot", "wrong"))
    return " ".join([counts, *(f"{cause} {n}" for cause, n in wrong.items())])


def _charts(motors: pl.DataFrame) -> dict[str, Nights]:
    """By method, each motor's nights to the first alarm."""
    rows = motors["rivals"].drop_nulls().to_list()
    return {name: [row[name] for row in rows] for name in (rows[0] if rows else ())}


def _first_alarms(motors: pl.DataFrame, nights: Nights) -> str:
    """First alarms a motor-year until the first alarm."""
    until = sum(n or left for n, left in zip(nights, motors["watched"], strict=True))
    return f"{(len(nights) - nights.count(None)) * YEAR / until:.2f}"


def _delay(motors: pl.DataFrame, nights: Nights) -> str:
    """Return the median and 90 % quantile, and how many were reported if not all."""
    ends = np.quantile([night or np.inf for night in nights], [0.5, 0.9], method="higher")
    median, late = (f"{end:.0f}" if np.isfinite(end) else f"> {motors['left'][0]}" for end in ends)
    reported = len(nights) - nights.count(None)
    of_all = "" if reported == len(nights) else f", {reported}/{len(nights)}"
    return f"{median} ({late}){of_all}"


def _rate(count: int, nights: int) -> str:
    """A motor-year, with the upper end of the exact 95 % interval of a count, and the years."""
    years = max(nights / YEAR, 1e-9)
    upper = float(gammaincinv(count + 1, 0.975))
    return f"{count}: {count / years:.3f} (≤ {upper / years:.2f}) in {years:.1f} years"


def _tonight(motors: pl.DataFrame) -> str:
    errors = np.array(motors["tonight"].to_list())
    return " / ".join(
        f"{100 * np.sqrt(np.mean(rms**2)):.1f} % ({100 * inside.mean():.0f} %)"
        for rms, inside in (errors[:, :2].T, errors[:, 2:].T)
    )


COLUMNS: dict[str, Callable[[pl.DataFrame], str]] = {
    "false a year": lambda motors: _rate(motors["false alarms"].sum(), motors["watched"].sum()),
    "more a year": lambda motors: _rate(motors["more"].sum(), motors["behind"].sum()),
    "nights": lambda motors: _delay(motors, motors["night"].to_list()),
    "names": _names,
    "charts": lambda m: "; ".join(_delay(m, nights) for nights in _charts(m).values()),
    "charts a year": lambda m: "; ".join(_first_alarms(m, chart) for chart in _charts(m).values()),
    "tonight": _tonight,
    "leakage": lambda motors: "{1:+.1f} % ({0:+.1f} to {2:+.1f} %)".format(
        *np.percentile(100.0 * motors["value"].to_numpy(), [0, 50, 100])
    ),
}  # fmt: skip


def _leakages(motors: pl.DataFrame) -> pl.DataFrame:
    """A row of each motor and place at which its leakage was asked for."""
    of = motors.with_columns(at=pl.lit(["reference conditions", "the motor's own"]))
    value, lower, upper = (pl.col("leakages").list.get(place) for place in range(3))
    return of.explode("leakages", "at").with_columns(
        value.alias("value"), ((lower <= 0.0) & (upper >= 0.0)).alias("held")
    )


def _likeliest_causes(motors: pl.DataFrame) -> pl.DataFrame:
    """Return a row of each cause that was likeliest, as reported and ten nights later."""
    later = motors.select(pl.col("P later").alias("P"), *RIGHTS[2:])
    of = pl.concat([motors.select("P", *RIGHTS[:2]), later], how="diagonal")
    return of.drop_nulls("P").sort("P")


README_CHARTS = ("mean flow, Shewhart", "regression, EWMA", "boosting, EWMA")
README_ROWS = {
    "healthy, alarms a motor-year": "healthy; plain",
    "winter to summer, oil 14 K warmer": "no wear; season: oil ± 7 K, winter first",
    "ring wears by 37 % of its gap in 120 nights": "wear; ring gap +37 % in 120 nights",
    "load halved": "no wear; load halved",
    "+20 % at once": "wear; all gaps' flow +20 % at once",
    "+10 % of leakage in a year": "wear; sleeve gap +9 % in a year (+10 % of leakage)",
}


def _readme_row(motors: pl.DataFrame) -> list[str]:
    """Return the rate of alarms, how many alarmed, or the median night, of watch and charts."""
    charts = [_charts(motors)[name] for name in README_CHARTS]
    every = [motors["night"].to_list(), *charts]
    if motors["group"][0] == "healthy":
        rate = motors["false alarms"].sum() * YEAR / motors["watched"].sum()
        return [f"{rate:.2f}", *(_first_alarms(motors, chart) for chart in charts)]
    if motors["group"][0] == "no wear":
        return [f"{len(nights) - nights.count(None)} of {len(nights)}" for nights in every]
    watch, *others = (_in_words(motors, nights) for nights in every)
    named = len(motors.filter(verdict="right"))
    return [f"{watch}, {named} of {len(motors)} named", *others]


def _in_words(motors: pl.DataFrame, nights: Nights) -> str:
    """Return the median night, or how many were not reported."""
    n, missed = len(nights), nights.count(None)
    if 2 * missed < n:
        return f"night {sorted(nights, key=lambda night: night or np.inf)[n // 2]}"
    return f"{missed} of {n} not in {motors['left'][0]} nights"


class Rows(NamedTuple):
    """Of a table: groups and columns, of which rows, and by what they come together."""

    groups: tuple[str, ...]
    header: str
    rows: Callable[[pl.DataFrame], pl.DataFrame] = lambda motors: motors
    keys: tuple[str, ...] = ("group", "change", "machine", "baseline")


CHANGES = ("wear", "no wear", "second change", "from the", "names", "tank")
TABLES = {
    "false alarms": Rows(
        ("healthy", "special"),
        "group | change | machine | baseline | false a year | false | notices | lack of fit | "
        "charts a year",
        lambda motors: motors.filter(pl.col("begin").is_null()),
    ),
    "reported changes": Rows(
        (*CHANGES, "special"),
        "group | change | machine | baseline | reported | nights | names | notices | charts",
    ),
    "false second alarms": Rows(("after a change",), "change | machine | more a year"),
    "probability": Rows(
        CHANGES,
        "P | right | less than right | right later | less than right later",
        _likeliest_causes,
        ("P",),
    ),
    "machines that nobody fitted": Rows(
        ("not fitted",),
        "machine | change | false | reported | soon | size held | part named | lack of fit | "
        "tonight",
    ),
    "since and size": Rows(
        ("after", *CHANGES, "special", "not fitted"),
        "machine | kind | since held | size held",
        lambda motors: motors.drop_nulls("kind").sort("machine", "kind"),
        ("machine", "kind"),
    ),
    "laminar": Rows(("laminar",), "change | at | leakage | held", _leakages, ("at",)),
    "record": Rows(("pump rig",), "change | false alarms | reported | nights | size | names"),
}
