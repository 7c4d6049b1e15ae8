"""The demo's motors, with the shipped configs."""

from __future__ import annotations

import datetime as dt

import pytest

from pipeline.config import MotorSpec, load_fleet
from pipeline.demo import shipped_configs
from pipeline.demo.fleet import DEMO_FLEET, DemoNight, Plan

PLAN = Plan(nights=75, minutes=90.0, rate_hz=5.0, seed=1, first_night=dt.date(2026, 1, 2))
MOTORS = {demo.motor_id: demo for demo in DEMO_FLEET}


@pytest.fixture(scope="module")
def specs() -> dict[str, MotorSpec]:
    fleet = load_fleet(shipped_configs() / "fleet.toml")
    return {spec.motor_id: spec for spec in fleet.motors}


def night_of(specs: dict[str, MotorSpec], motor_id: str, number: int = 1) -> DemoNight:
    return DemoNight(MOTORS[motor_id], specs[motor_id], PLAN, number)
