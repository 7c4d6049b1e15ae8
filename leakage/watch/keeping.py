"""The state of a watch as arrays of numbers, and back: what a run keeps for the next one."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, fields
from typing import Any

import numpy as np

from leakage.watch.attribution import Attribution
from leakage.watch.baseline import Baseline, Columns
from leakage.watch.causes import BACK, Cause
from leakage.watch.evidence import Sums, Window
from leakage.watch.nights import Array, Change, Estimate, Machine, WatchSettings
from leakage.watch.state import ChangeInForce, State, all_causes
from leakage.watch.wander import Wander
from leakage.watch.within_night import BlockErrors

Arrays = dict[str, Any]
# Scalars of each part, in order; what has no value is nan.
OF_COLUMNS = ("least_scale", "temperature_c", "has_zero")
OF_BASELINE = ("lack_of_fit", "identifies_gaps", "identifies_speed")
WHOLE_OF_STATE = ("first_step", "first_ramp", "n_baseline", "n_nights", "due")
OF_STATE = (*WHOLE_OF_STATE, "often", "evidence", "period_from")


def arrays_of(state: State) -> dict[str, Array]:
    """All numbers of a state, by name."""
    baseline, window, columns = state.baseline, state.window, state.baseline.columns
    undone = [one for one in state.causes.every if one.name == BACK]
    kept: Arrays = {
        **{f"columns.{name}": getattr(columns, name) for name in _arrays(Columns, OF_COLUMNS)},
        "columns": _scalars(columns, OF_COLUMNS),
        **{f"baseline.{name}": getattr(baseline, name) for name in _of_baseline()},
        "baseline": _scalars(baseline, OF_BASELINE),
        "errors": np.array([getattr(baseline.errors, one.name) for one in fields(BlockErrors)]),
        **{f"window.{one.name}": getattr(window, one.name) for one in fields(Window)},
        "wander.spread": state.wander.spread,
        "wander.memory": state.wander.memory,
        "wander.common": state.wander.common,
        "undone": np.array([one.direction for one in undone]).reshape(-1, columns.n),
        "undone.size": np.array([(one.mean, one.spread) for one in undone]).reshape(-1, 2),
        "carried": np.array([state.carried.value, state.carried.sd]),
        "state": _scalars(state, OF_STATE),
    }
    return kept | _of_in_force("standing", state.in_force)


def state_of(machine: Machine, settings: WatchSettings, kept: Mapping[str, Any]) -> State:
    """The state that was kept."""
    least_scale, temperature_c, has_zero = kept["columns"].tolist()
    columns = Columns(
        least_scale=least_scale,
        temperature_c=temperature_c,
        has_zero=bool(has_zero),
        **{name: kept[f"columns.{name}"] for name in _arrays(Columns, OF_COLUMNS)},
    )
    lack, *tells = kept["baseline"].tolist()
    baseline = Baseline(
        columns=columns,
        errors=BlockErrors(*kept["errors"].tolist()),
        lack_of_fit=lack,
        identifies_gaps=bool(tells[0]),
        identifies_speed=bool(tells[1]),
        **{name: kept[f"baseline.{name}"] for name in _of_baseline()},
    )
    window = Window(**{one.name: kept[f"window.{one.name}"] for one in fields(Window)})
    wander = Wander(kept["wander.spread"], kept["wander.memory"], kept["wander.common"])
    undone = zip(kept["undone"], kept["undone.size"].tolist(), strict=True)
    numbers = dict(zip(OF_STATE, kept["state"].tolist(), strict=True))
    period_from = numbers.pop("period_from")
    numbers |= {name: int(numbers[name]) for name in WHOLE_OF_STATE}
    return State(
        machine,
        settings,
        baseline,
        window,
        sums=Sums.of(window, wander),
        wander=wander,
        causes=all_causes(
            machine,
            baseline,
            [Cause(BACK, along, mean, spread) for along, (mean, spread) in undone],
        ),
        period_from=None if np.isnan(period_from) else int(period_from),
        carried=Estimate(*kept["carried"].tolist()),
        in_force=_in_force_of("standing", kept),
        **numbers,
    )


def _arrays(kind: type, scalars: tuple[str, ...]) -> list[str]:
    return [one.name for one in fields(kind) if one.name not in scalars]


def _of_baseline() -> list[str]:
    return _arrays(Baseline, ("columns", "errors", *OF_BASELINE))


def _scalars(part: Any, names: tuple[str, ...]) -> Array:
    values = (getattr(part, name) for name in names)
    return np.array([np.nan if one is None else float(one) for one in values])


def _of_in_force(name: str, in_force: ChangeInForce | None) -> Arrays:
    """A change in force: its words as the bytes of a text."""
    if in_force is None:
        return {}
    found = in_force.found
    words = {
        "change": asdict(in_force.change),
        "of_flow": in_force.of_flow,
        "before": asdict(in_force.before),
        "tank": None if in_force.tank is None else asdict(in_force.tank),
    }
    if found is not None:
        words["found"] = asdict(found) | {"weights": None}
    text = np.frombuffer(json.dumps(words).encode(), dtype=np.uint8)
    kept: Arrays = {name: text, f"{name}.along": in_force.along}
    if found is not None:
        kept[f"{name}.weights"] = found.weights
    return kept | _of_in_force(f"{name}.prior", in_force.prior)


def _in_force_of(name: str, kept: Mapping[str, Any]) -> ChangeInForce | None:
    if name not in kept:
        return None
    words = json.loads(bytes(kept[name]))
    change = words["change"]
    for one in ("size", "path_growth"):
        change[one] = None if change[one] is None else Estimate(**change[one])
    found = words.get("found")
    if found is not None:
        sizes = {one: Estimate(**found[one]) for one in ("size", "flow")}
        since = {"since": tuple(found["since"]), "weights": kept[f"{name}.weights"]}
        found = Attribution(**(found | sizes | since))
    return ChangeInForce(
        Change(**change),
        kept[f"{name}.along"],
        words["of_flow"],
        Estimate(**words["before"]),
        found,
        _in_force_of(f"{name}.prior", kept),
        None if words["tank"] is None else Estimate(**words["tank"]),
    )
