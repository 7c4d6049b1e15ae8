"""Tables of what was found, a table for each thing that is shown."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from scipy.special import gammaincinv

from benchmarks.results_file import Part, table
from benchmarks.watch.cells import BASELINE, NOTHING, YEAR, Cell
from benchmarks.watch.outcomes import Outcome
from benchmarks.watch.simulator import PATHS

SOON = 3  # nights within which a wear that has reached 8 % is to be told, the first being 1
PARTS = {*PATHS, "known"}  # what a change may be called that names a part
Found = Sequence[tuple[Cell, list[Outcome]]]
Rows = Iterator[Sequence[str]]


def parts(cells: Mapping[str, Cell], found: Mapping[str, Any]) -> Iterator[Part]:
    """Tables of all that was found."""
    known = [(cell, found[key]) for key, cell in cells.items() if key in found]
    for heading, text, header, groups, rows in TABLES:
        body = list(rows([one for one in known if one[0].group.startswith(groups)]))
        if body:
            yield Part(heading, text, header, body)


def readme(cells: Mapping[str, Cell], found: Mapping[str, Any]) -> list[str]:
    """The README's table; a row that was not measured has no figures."""
    header = " | ".join(("", "watch", *README_CHARTS))
    rows = []
    for words, key in README_ROWS.items():
        name = f"{key}; otherwise; {BASELINE}"
        row = _readme_row(cells[name], found[name]) if name in found else ["–"] * 4
        rows.append([words, *row])
    return table(header, rows)


def _new(outcome: Outcome) -> list[Outcome]:
    """What was detected as an alarm and was not told before."""
    return [one for one in outcome["told"] if not (one["is_notice"] or one["goes_on"])]


def _notices(motors: Sequence[Outcome]) -> str:
    return str(sum(one["is_notice"] for motor in motors for one in motor["told"]))


def _begin(cell: Cell) -> int:
    return max(cell.baseline, cell.event.begin or 0)


def _early(cell: Cell, motors: Sequence[Outcome]) -> list[list[Outcome]]:
    """Of each motor the alarms before anything is otherwise."""
    end = cell.event.nights if cell.event.begin is None else _begin(cell)
    return [[one for one in _new(motor) if one["night"] < end] for motor in motors]


def _firsts(cell: Cell, motors: Sequence[Outcome]) -> list[Outcome | None]:
    """Of each motor what is detected first of the change, or since the baseline.

    An alarm, or a notice that is right; the same again, where it was detected before the change.
    """

    def tells(one: Outcome) -> bool:
        is_alarm = not one["is_notice"] or one["first"][0] in cell.event.right
        return is_alarm and one["night"] >= _begin(cell)

    return [next(filter(tells, motor["told"]), None) for motor in motors]


def _known(firsts: Sequence[Outcome | None]) -> list[Outcome]:
    return [one for one in firsts if one is not None]


def verdict(cell: Cell, told: Outcome) -> str:
    """``right``, ``cannot`` be told, ``wrong``: as it stands ten nights later."""
    cause = told["cause"][0]
    if cause in cell.event.right:
        return "right"
    return "cannot" if cause == "cannot_be_told" or cause in cell.event.near else "wrong"


def _counts(cell: Cell, motors: Sequence[Outcome]) -> str:
    """Names: right / cannot be identified / wrong, and the wrong ones."""
    told = _known(_firsts(cell, motors))
    said = Counter(verdict(cell, one) for one in told)
    wrong = Counter(one["cause"][0] for one in told if verdict(cell, one) == "wrong")
    counts = "/".join(str(said[one]) for one in ("right", "cannot", "wrong"))
    return " ".join([counts, *(f"{cause} {n}" for cause, n in wrong.items())])


def _charts(motors: Sequence[Outcome]) -> dict[str, list[int | None]]:
    """By method, each motor's nights to the first alarm."""
    return {name: [one["rivals"][name] for one in motors] for name in motors[0].get("rivals", ())}


def _years(cell: Cell, motors: Sequence[Outcome]) -> float:
    return len(motors) * (cell.event.nights - cell.baseline) / YEAR


def _first_alarms(cell: Cell, firsts: Sequence[int | None]) -> str:
    """First alarms a motor-year until the first alarm."""
    nights = cell.event.nights - cell.baseline
    years = sum(nights if one is None else one for one in firsts) / YEAR
    return f"{sum(one is not None for one in firsts) / years:.2f}"


def _rate(count: int, years: float) -> str:
    """With the upper end of the exact 95 % interval of a count."""
    upper = float(gammaincinv(count + 1, 0.975))
    return f"{count}: {count / max(years, 1e-9):.3f} (≤ {upper / max(years, 1e-9):.2f})"


def _share(held: Sequence[bool]) -> str:
    n, count = len(held), sum(held)
    return f"{count} of {n} ({100 * count / n:.0f} %)" if n else "–"


def _false_alarms(found: Found) -> Rows:
    for cell, motors in found:
        if cell.event.begin is not None:
            continue
        told, years = _early(cell, motors), _years(cell, motors)
        yield (
            cell.words if cell.group == "healthy" else cell.group,
            cell.machine,
            str(cell.baseline),
            f"{years:.0f}",
            _rate(sum(map(len, told)), years),
            str(sum(map(bool, told))),
            _notices(motors),
            f"{100 * np.mean([one['lack'] for one in motors]):.1f} %",
            "; ".join(_first_alarms(cell, one) for one in _charts(motors).values()),
        )


def _nights(cell: Cell, motors: Sequence[Outcome]) -> list[int | None]:
    """Nights to the first alarm, the change's first being 1."""
    firsts = _firsts(cell, motors)
    return [None if one is None else one["night"] - (cell.event.begin or 0) + 1 for one in firsts]


def _delay(cell: Cell, firsts: Sequence[int | None]) -> str:
    """Median and 90 % quantile, and how many were told if not all."""
    known = [np.inf if one is None else one for one in firsts]
    ends = np.quantile(known, [0.5, 0.9], method="higher")
    left = cell.event.nights - (cell.event.begin or 0)
    median, late = (f"{one:.0f}" if np.isfinite(one) else f"> {left}" for one in ends)
    told = sum(one is not None for one in firsts)
    return f"{median} ({late})" + ("" if told == len(firsts) else f", {told}/{len(firsts)}")


def _told(found: Found) -> Rows:
    for cell, motors in found:
        if cell.event is NOTHING:
            continue
        told = len(_known(_firsts(cell, motors)))
        yield (
            cell.group,
            cell.words,
            cell.machine,
            str(cell.baseline),
            f"{told} of {len(motors)}",
            _delay(cell, _nights(cell, motors)),
            _counts(cell, motors),
            _notices(motors),
            "; ".join(_delay(cell, one) for one in _charts(motors).values()),
        )


def _second_alarms(found: Found) -> Rows:
    for cell, motors in found:
        told = zip(_firsts(cell, motors), map(_new, motors), strict=True)
        behind = [(first["night"], new) for first, new in told if first is not None]
        years = sum(cell.event.nights - night for night, _ in behind) / YEAR
        more = sum(one["night"] > night for night, new in behind for one in new)
        yield cell.words, cell.machine, f"{years:.1f}", _rate(more, years)


def _probabilities(found: Found) -> Rows:
    """Whether what is likeliest is right as often as is said."""
    told = [(cell, one) for cell, motors in found for one in _known(_firsts(cell, motors))]
    for tenth in range(1, 10 if told else 0):
        row = [f"{tenth / 10:.1f} to {(tenth + 1) / 10:.1f}"]
        for when in ("first", "cause"):
            of = [(cell.event, one[when]) for cell, one in told]
            names = [(event, one[1]) for event, one in of if min(int(10 * one[2]), 9) == tenth]
            right = sum(name in event.right for event, name in names)
            near = sum(name in event.near for event, name in names)
            row.append(f"{right} + {near} of {len(names)}" if names else "–")
        yield row


def _not_fitted(found: Found) -> Rows:
    for cell, motors in found:
        firsts = _firsts(cell, motors)
        pairs = [(one["reached"], told) for one, told in zip(motors, firsts, strict=True)]
        soon = [
            told is not None and told["night"] < night + SOON
            for night, told in pairs
            if night is not None
        ]
        named = sum(any(map(_names_a_part, one["told"])) for one in motors)
        is_change = cell.event.begin is not None
        yield (
            cell.machine,
            cell.words,
            str(sum(map(bool, _early(cell, motors)))),
            f"{len(_known(firsts))} of {len(firsts)}" if is_change else "–",
            f"{sum(soon)} of {len(soon)}" if soon else "–",
            _share(_sizes_held(firsts)) if is_change else "–",
            str(named),
            f"{100 * float(np.mean([one['lack'] for one in motors])):.1f} %",
            _errors(motors),
        )


def _names_a_part(told: Outcome) -> bool:
    causes = {one for when in ("first", "cause") for one in told[when][0].split(" and ")}
    return bool(PARTS & causes)


def _sizes_held(firsts: Sequence[Outcome | None]) -> list[bool]:
    """Whether the true size of a change that stays is within its interval."""
    sized = [one for one in _known(firsts) if one["cause"][0] != "odd_nights"]
    return [one["size"][1] <= one["true"] <= one["size"][2] for one in sized]


def _errors(motors: Sequence[Outcome]) -> str:
    found = np.array([one["tonight"] for one in motors])
    return " / ".join(
        f"{100 * np.sqrt(np.mean(rms**2)):.1f} % ({100 * inside.mean():.0f} %)"
        for rms, inside in (found[:, :2].T, found[:, 2:].T)
    )


def _sizes(found: Found) -> Rows:
    """By machine and kind of change; where nothing changes, nothing has a size."""
    held: dict[tuple[str, str], tuple[list[bool], list[bool]]] = {}
    for cell, motors in found:
        event = cell.event
        if event.begin is None or not (event.right or event.near):
            continue
        kind = "step" if event.is_step else "ramp" if event.begin else "ramp from the first night"
        since, size = held.setdefault((cell.machine, kind), ([], []))
        firsts = _firsts(cell, motors)
        since += [one["since"][0] <= event.begin <= one["since"][2] for one in _known(firsts)]
        size += _sizes_held(firsts)
    for key, lists in sorted(held.items()):
        yield (*key, *map(_share, lists))


def _laminar(found: Found) -> Rows:
    for cell, motors in found:
        for place, words in enumerate(("reference conditions", "the motor's own")):
            values, lower, upper = np.array([motor["leakages"][place] for motor in motors]).T
            ends = f"{100.0 * values.min():+.1f} to {100.0 * values.max():+.1f} %"
            held = _share(((lower <= 0.0) & (upper >= 0.0)).tolist())
            yield cell.words, words, f"{100.0 * np.median(values):+.1f} %", ends, held


def _rig(found: Found) -> Rows:
    for cell, motors in found:
        nights = [str(one or "–") for one in _nights(cell, motors)]
        told = _known(_firsts(cell, motors))
        sizes = [
            "{:+.1f} ({:+.1f} to {:+.1f}) %".format(*np.multiply(100.0, one["size"]))
            for one in told
        ]
        early = str(sum(map(len, _early(cell, motors))))
        is_change = cell.event.begin is not None
        yield (
            cell.words,
            early,
            ", ".join(nights) if is_change else "–",
            sizes[0] if sizes else "–",
            ", ".join(one["cause"][0] for one in told),
        )


README_CHARTS = ("mean flow, Shewhart", "regression, EWMA", "boosting, EWMA")
README_ROWS = {
    "healthy, alarms a motor-year": "healthy; plain",
    "winter to summer, oil 14 K warmer": "no wear; season: oil ± 7 K, winter first",
    "ring wears by 37 % of its gap in 120 nights": "wear; ring gap +37 % in 120 nights",
    "load halved": "no wear; load halved",
    "+20 % at once": "wear; all gaps' flow +20 % at once",
    "+10 % of leakage in a year": "wear; sleeve gap +9 % in a year (+10 % of leakage)",
}


def _readme_row(cell: Cell, motors: Sequence[Outcome]) -> list[str]:
    charts = [_charts(motors)[name] for name in README_CHARTS]
    if cell.group == "healthy":
        rate = sum(map(len, _early(cell, motors))) / _years(cell, motors)
        return [f"{rate:.2f}", *(_first_alarms(cell, one) for one in charts)]
    every = [_nights(cell, motors), *charts]
    if cell.group == "no wear":
        return [f"{len(one) - one.count(None)} of {len(one)}" for one in every]
    watch, *others = (_in_words(cell, one) for one in every)
    named = sum(verdict(cell, one) == "right" for one in _known(_firsts(cell, motors)))
    return [f"{watch}, {named} of {len(motors)} named", *others]


def _in_words(cell: Cell, firsts: Sequence[int | None]) -> str:
    """The median night, or how many were not told."""
    n, missed = len(firsts), firsts.count(None)
    if 2 * missed < n:
        return f"night {sorted(firsts, key=lambda one: one or np.inf)[n // 2]}"
    return f"{missed} of {n} not in {cell.event.nights - _begin(cell)} nights"


CB560 = ("healthy", "wear", "no wear", "from the", "after", "second", "special", "names", "tank")
TABLES: tuple[tuple[str, str, str, tuple[str, ...], Callable[[Found], Rows]], ...] = (
    (
        "False alarms",
        "Changes told a motor-year, all causes, with the upper end of an exact 95 % interval; the "
        "same again counts once. Notices are changes of the temperature's effect alone, and ends "
        "of what was told. Of charts, first alarms a motor-year until the first.",
        "world | machine | baseline | years | told | motors | notices | lack of fit | charts",
        ("healthy", "special"),
        _false_alarms,
    ),
    (
        "What was told",
        "Motors that alarmed; nights to the first alarm, median (90 % quantile), the change's "
        "first being 1; names as they stand ten nights later: right / cannot be told / wrong.",
        "group | change | machine | baseline | told | nights | names | notices | charts in order",
        ("wear", "no wear", "second change", "from the", "special", "names", "tank"),
        _told,
    ),
    (
        "False second alarms",
        "Second changes told a motor-year after a first, where there is none.",
        "first | machine | years | told",
        ("after a change",),
        _second_alarms,
    ),
    (
        "Probability",
        "Changes whose likeliest cause is right + less than right, by its probability; also where "
        "nothing that has a name has changed.",
        "P | when it was told | ten nights later",
        ("names", "wear", "no wear", "from the", "second", "tank"),
        _probabilities,
    ),
    (
        "Machines that nobody fitted",
        f"Motors with false alarms; motors told; told by night {SOON} of reaching 8 %; first sizes "
        "within their intervals; motors with a part named; tonight's change, rms error (within "
        "interval), at the night's own conditions / at the motor's.",
        "machine | what | false | told | soon | sizes | part named | lack of fit | tonight",
        ("not fitted",),
        _not_fitted,
    ),
    (
        "Since and size",
        "Nominal 95 % intervals of the first change told, as they are ten nights later. Wear from "
        "the first night on began before anything could be told of it: its size is against the "
        "baseline.",
        "machine | change | since held | size held",
        (*CB560, "not fitted"),
        _sizes,
    ),
    (
        "A healthy all-laminar machine",
        "Leakage by the level of the last night over the true one, less 1; nothing has changed.",
        "what | at | median | range | within the interval",
        ("laminar",),
        _laminar,
    ),
    (
        "A real pump's record",
        "False alarms before; nights from the change to the alarm; the first one's size.",
        "nights | before | told in night | size | name",
        ("pump rig",),
        _rig,
    ),
)
