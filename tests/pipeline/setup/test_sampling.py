"""Apparent sampling of a channel, on signals logged in each way by its definition."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pipeline.config import Channel, load_fleet
from pipeline.config.channels import COUNTED
from pipeline.ingest import RawChannel, read_log
from pipeline.setup.sampling import Sampling, configured, look_of, remark, words
from tests.pipeline.signals import (
    Signal,
    counted,
    jittered,
    moving_load,
    noisy,
    sampled,
    sent_on_change,
    stamps,
    swinging_door,
    wandering,
    with_losses,
    with_spikes,
)

HOURS = 2 * 3600.0
STEPS = {"pressure": 0.1, "temperature": 0.1, "flow": 0.02}
SEEDS = range(4)


def generator(seed: int) -> np.random.Generator:
    return np.random.default_rng([7, seed])


def signal(name: str, seed: int) -> Signal:
    """Signal as a sensor sees it, including its own noise of half a step."""
    rng = generator(seed)
    made = {
        "pressure": lambda: moving_load(rng, HOURS, (20.0, 250.0), 15.0),
        "temperature": lambda: wandering(rng, HOURS, 50.0, 3.0, 900.0),
        "flow": lambda: wandering(rng, HOURS, 1.5, 0.4, 20.0),
    }[name]()
    return noisy(rng, made, 0.5 * STEPS[name])


def look(one: Signal, name: str = "pressure") -> Sampling:
    blank = np.zeros(one.value.size, dtype=np.bool_)
    return look_of(RawChannel(stamps(one.time_s), one.value, blank, 0), is_flow=name == "flow")


Logged = Callable[[Signal, float, np.random.Generator], Signal]

PERIODIC: dict[str, Logged] = {
    "5 Hz": lambda s, step, _: sampled(s, 0.2, step),
    "5 Hz, fine": lambda s, _step, _rng: sampled(s, 0.2),
    "1 Hz": lambda s, step, _: sampled(s, 1.0, step),
    "every 10 s": lambda s, step, _: sampled(s, 10.0, step),
    "every 60 s": lambda s, step, _: sampled(s, 60.0, step),
    "jitter": lambda s, step, rng: jittered(rng, sampled(s, 1.0, step), 0.15),
    "a third lost": lambda s, step, rng: with_losses(rng, sampled(s, 0.2, step), 0.33),
    "spikes": lambda s, step, rng: with_spikes(rng, sampled(s, 0.2, step), 0.002, 900 * step),
}


@pytest.mark.parametrize("name", STEPS)
@pytest.mark.parametrize("way", PERIODIC)
def test_readings_look_periodic_and_nothing_else(name: str, way: str) -> None:
    for seed in SEEDS:
        logged = PERIODIC[way](signal(name, seed), STEPS[name], generator(100 + seed))
        assert look(logged, name).kind == "periodic"


IRREGULAR = [
    *(("pressure", steps) for steps in (1, 5, 20)),
    *(("temperature", 3), ("flow", 5), ("flow", 20)),
]


@pytest.mark.parametrize(("name", "steps"), IRREGULAR)
def test_values_sent_on_change_or_compressed_look_irregular(name: str, steps: int) -> None:
    for seed in SEEDS:
        one = signal(name, seed)
        sent = sent_on_change(one, 0.2, STEPS[name], steps * STEPS[name])
        found = look(sent, name)
        assert found.kind == "irregular"
        # The longest but for a hundredth: of use as longest_silence_s.
        assert 0.98 < np.mean(np.diff(sent.time_s) <= (found.longest_silence_s or 0.0)) <= 1.0
        left = swinging_door(one, 1.0, STEPS[name], max(steps, 5) * STEPS[name])
        assert look(left, name).kind == "irregular"


@pytest.mark.parametrize("volume_cm3", [1.0, 10.0])
@pytest.mark.parametrize("period_s", [0.2, 1.0, 10.0])
def test_a_running_total(volume_cm3: float, period_s: float) -> None:
    for seed in SEEDS:
        flow = wandering(generator(seed), HOURS, 1.5, 0.4, 20.0)
        assert look(counted(flow, period_s, volume_cm3, 123.0), "flow").kind == "cumulative"
    if period_s < 10.0:
        over = counted(flow, period_s, 10.0, rolls_over=10_000.0)
        assert look(over, "flow").kind == "cumulative"


def test_a_temperature_that_only_rises_is_no_total() -> None:
    time_s = np.arange(3000.0)
    warming = Signal(time_s, np.round(40.0 + time_s / 300.0, 1))
    assert look(warming, "temperature").kind == "periodic"


def test_few_samples_or_no_change_tell_nothing() -> None:
    for count in (0, 1, 5):
        time_s = np.arange(float(count))
        assert look(Signal(time_s, time_s)).kind == "unknown"
    assert look(Signal(np.arange(500.0), np.full(500, 3.0))).kind == "unknown"
    assert words(Sampling("unknown")) == ""


def test_samples_are_put_in_order_and_what_is_missing_left_out() -> None:
    load = noisy(generator(8), moving_load(generator(9), 1800.0, (20.0, 250.0), 15.0), 0.05)
    one = sent_on_change(load, 0.2, 0.1, 0.5)
    order = generator(1).permutation(one.value.size)
    time_us = np.repeat(stamps(one.time_s)[order], 2)
    value = np.repeat(one.value[order], 2)
    value[1::2] = np.nan
    missing = np.tile([False, True], order.size)
    missing[1::4] = False
    assert look_of(RawChannel(time_us, value, missing, 0)) == look(one)


PLAIN = {"source": "x", "unit": "l/min"}
SENT = {"sampling": "on_change", "longest_silence_s": 60.0}
TOTAL = {"unit": "count", "counts": "cumulative", "volume_per_count_cm3": 1.0}


@pytest.mark.parametrize(
    ("config", "agreeing"),
    [
        ({}, {"periodic"}),
        (SENT, {"periodic", "irregular"}),
        ({"sampling": "mean", "mean_of_s": 10.0}, {"periodic"}),
        ({"sampling": "mean", "mean_of_s": 60.0}, set()),
        (TOTAL, {"cumulative"}),
        (TOTAL | {"counts": "pulses"}, {"periodic", "irregular"}),
    ],
    ids=["periodic", "on_change", "mean", "mean of another period", "cumulative", "pulses"],
)
def test_a_remark_where_look_and_config_disagree(
    config: dict[str, Any], agreeing: set[str]
) -> None:
    channel = Channel.model_validate(PLAIN | config)
    for kind in ("periodic", "irregular", "cumulative"):
        told = remark(channel, Sampling(kind, 10.0, 30.0, 0.01))
        said = f"configured as {configured(channel)}, looks {words(Sampling(kind, 10.0))}"
        assert told == "" if kind in agreeing else told.startswith(said)
    assert remark(channel, Sampling("unknown")) == ""


def test_a_remark_says_what_to_write() -> None:
    plain, sent = (Channel.model_validate(PLAIN | more) for more in ({}, SENT))
    for kind, told in {
        "irregular": 'then sampling = "on_change" and longest_silence_s; silences here reach 30 s',
        "cumulative": 'then counts = "cumulative", unit = "count" and volume_per_count_cm3',
    }.items():
        assert remark(plain, Sampling(kind, 10.0, 30.0)).endswith(told)
    assert "45 % of them as the one before" in remark(sent, Sampling("periodic", 0.2, 0.2, 0.45))
    total = Channel.model_validate(PLAIN | TOTAL)
    assert remark(total, Sampling("periodic", 1.0)).endswith("it falls again and again")


def test_nothing_of_the_demo_is_remarked_on(demo_folder: Path) -> None:
    """Every channel of every log of the demo fleet is periodic, and looks so."""
    fleet = load_fleet(demo_folder / "configs" / "fleet.toml")
    looked_at = 0
    for spec in fleet.motors:
        for path in sorted((fleet.log_root / spec.motor_id).iterdir()):
            log = read_log(path, spec.file.logs, spec.file.channels)
            for name, channel in spec.file.channels.items():
                found = look_of(log.channels[name], is_flow=name == COUNTED)
                assert (found.kind, remark(channel, found)) == ("periodic", "")
                looked_at += 1
    assert looked_at == 3 * (5 * 4 + 5)
