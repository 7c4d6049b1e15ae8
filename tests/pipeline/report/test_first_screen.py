"""First screen of a motor's page: gap changes with their limits, and leakage by path."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from pipeline.report.first_screen import FirstScreen, first_screen
from pipeline.trends.rows.motor_states import MotorState
from tests.pipeline.report.nights import fit, history, trend

# model.md, section 3: the CB560 at 200 bar, 50 °C and 30 rpm; flow of one interface of 32, l/min.
FLOWS = {
    "piston_ring": 3.445024e-4,
    "balance_piston": 1.061377e-2,
    "balance_sleeve": 1.529589e-2,
    "cam_roller": 1.660281e-2,
}
TOTAL = 1.371423
PATHS = tuple(FLOWS)
FREE = PATHS[:3]
OK = MotorState("M", "ok")
# model.md, section 4: a loss factor of the ring, m³.
K = 7.506312e-14
LIMITS = {"baseline_mean": K, "warning_limit": 1.15 * K, "alarm_limit": 1.30 * K}


def screen(
    rows: list[dict[str, Any]],
    state: MotorState = OK,
    leakage: float | None = TOTAL,
    nights: int = 1,
) -> FirstScreen:
    fits = [fit(n, leakage, mean_flow_l_per_min=5.0) for n in range(nights)]
    return first_screen(history(fits, rows), state, PATHS)


def leakages(night: int = 0) -> list[dict[str, Any]]:
    return [trend(night, f"leakage_{path}", 32 * FLOWS[path]) for path in FREE]


def test_leakage_by_path_adds_up_and_the_rest_is_that_of_the_path_that_is_not_fitted() -> None:
    found = screen([*leakages(), trend(0, "reference_leakage", TOTAL)])
    flows = {line.name: line.course.value[0] for line in found.paths}
    names = [path.replace("_", " ") for path in FREE]
    assert list(flows) == [*names, "cam roller (the rest)"]
    assert sum(flows.values()) == pytest.approx(TOTAL, rel=1e-12)
    assert flows["cam roller (the rest)"] == pytest.approx(32 * FLOWS["cam_roller"], rel=1e-5)
    assert [line.place for line in found.paths] == [0, 1, 2, 3]


def test_a_night_that_does_not_tell_every_free_path_has_no_parts() -> None:
    rows = [*leakages(0), *leakages(1)[:2]]
    (first, second) = np.transpose([line.course.value for line in screen(rows, nights=2).paths])
    assert np.isfinite(first).all()
    assert np.isnan(second).all()


def test_parts_of_another_leakage_than_the_reference_are_not_shown() -> None:
    found = screen([*leakages(), trend(0, "own_reference_leakage", 2.0)], leakage=None)
    assert found.leakage_kind == "frozen"
    assert found.paths == ()


def test_limits_of_a_gap_are_those_of_its_loss_factor_by_the_cube_root() -> None:
    """Q(2h)/Q(h) = 8 (model.md, section 8), so K ∝ h³: 1.15^⅓ = 1.0477 and 1.30^⅓ = 1.0914."""
    rows = [trend(0, "gap_change_piston_ring", 29.6, lower=29.0, upper=30.3)]
    rows.append(trend(0, "K_piston_ring", 2.17 * K, **LIMITS))
    found = screen(rows)
    (line,) = found.changes
    assert (line.name, line.place, line.now) == ("piston ring", 0, (29.6, 29.0, 30.3))
    assert found.limits["warning"] == pytest.approx([4.769], abs=1e-3)
    assert found.limits["alarm"] == pytest.approx([9.139], abs=1e-3)
    assert found.limits_of == "piston ring gap"


@pytest.mark.parametrize(
    ("state", "leading"),
    [
        (MotorState("M", "alarm", indicator="K_balance_sleeve"), "balance sleeve gap"),
        (MotorState("M", "ok", gap_path="balance_sleeve"), "balance sleeve gap"),
        (MotorState("M", "alarm", indicator="reference_leakage"), "piston ring gap"),
    ],
)
def test_the_limits_are_those_of_the_gap_that_the_state_is_of(
    state: MotorState, leading: str
) -> None:
    rows = [trend(0, f"gap_change_{path}", 1.0) for path in FREE]
    rows += [trend(0, f"K_{path}", K, **LIMITS) for path in ("piston_ring", "balance_sleeve")]
    assert screen(rows, state).limits_of == leading


def test_a_motor_at_one_pressure_shows_the_change_of_its_leakage() -> None:
    rows = [
        trend(0, "own_reference_leakage", 3.0, lower=2.9, upper=3.1, baseline_mean=2.0)
        | {"warning_limit": 2.3, "alarm_limit": 2.6},
        trend(0, "leakage_piston_ring", 0.03, gated_reason="known to ± 1290 %"),
    ]
    found = screen(rows, MotorState("M", "alarm", indicator="own_reference_leakage"), leakage=None)
    (line,) = found.changes
    assert line.place is None
    assert line.now == pytest.approx((50.0, 45.0, 55.0))
    assert found.limits["warning"] == pytest.approx([15.0])
    assert found.limits["alarm"] == pytest.approx([30.0])
    assert found.paths == ()


def test_a_young_motor_shows_its_flow_and_one_without_any_night_nothing() -> None:
    rows = [trend(0, "comparable_drain_flow", 4.4), trend(0, "drain_flow", 5.5)]
    found = screen(rows, MotorState("M", "insufficient"), leakage=None)
    assert found.changes == found.paths == ()
    assert found.limits == {}
    assert (found.leakage_kind, found.leakage.value.tolist()) == ("comparable", [4.4])
    assert found.flow.value.tolist() == [5.5]
    none = screen([], MotorState("M", "insufficient"), nights=0)
    assert none.changes == none.paths == ()
    assert len(none.flow.value) == 0
