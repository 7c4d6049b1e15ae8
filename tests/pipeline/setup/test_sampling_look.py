"""Apparent sampling of a channel, on signals logged in each way by its definition."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pipeline.config import Channel, load_fleet
from pipeline.config.channels import COUNTED
from pipeline.ingest import RawChannel, read_log
from pipeline.setup.sampling_look import Kind, Sampling, configured, look_of, remark, words
from tests.pipeline.signals import (
    Signal,
    averaged,
    counted,
    jittered,
    moving_load,
    noisy,
    pulses,
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


def look(one: Signal, name: str = "pressure", resolution: float | None = None) -> Sampling:
    blank = np.zeros(one.value.size, dtype=np.bool_)
    raw = RawChannel(stamps(one.time_s), one.value, blank, 0)
    step = STEPS[name] if resolution is None else resolution
    return look_of(raw, is_flow=name == "flow", resolution=step)


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


ON_CHANGE = [
    *(("pressure", steps) for steps in (0, 1, 5, 20)),
    *(("temperature", steps) for steps in (1, 3, 5)),
    *(("flow", steps) for steps in (3, 5, 20)),
]


@pytest.mark.parametrize(("name", "steps"), ON_CHANGE)
@pytest.mark.parametrize("fine", [False, True])
def test_a_value_sent_on_change_looks_irregular(name: str, steps: int, fine: bool) -> None:
    if fine and steps == 0:
        return
    for seed in SEEDS:
        one = signal(name, seed)
        sent = sent_on_change(one, 0.2, 0.0 if fine else STEPS[name], steps * STEPS[name])
        found = look(sent, name)
        assert found.kind == "irregular"
        # The longest but for a hundredth: of use as longest_silence_s.
        silences = np.diff(sent.time_s)
        assert 0.98 < np.mean(silences <= (found.longest_silence_s or 0.0)) <= 1.0


SWINGING_DOOR = [
    *(("pressure", steps) for steps in (2, 5, 10, 30)),
    *(("temperature", 2), ("flow", 5), ("flow", 15)),
]


@pytest.mark.parametrize(("name", "steps"), SWINGING_DOOR)
def test_what_a_swinging_door_leaves_looks_irregular(name: str, steps: int) -> None:
    for seed in SEEDS:
        left = swinging_door(signal(name, seed), 1.0, STEPS[name], steps * STEPS[name])
        assert look(left, name).kind == "irregular"


@pytest.mark.parametrize("period_s", [10.0, 20.0])
def test_means_of_a_slow_signal_by_the_correlation_of_their_differences(period_s: float) -> None:
    """Working's 1/4 is met whatever the digits; readings of the same signal have none."""
    for seed in SEEDS:
        one = wandering(generator(seed), 6 * 3600.0, 120.0, 30.0, 900.0, step_s=0.1)
        changes = np.diff(averaged(one, period_s).value)
        assert np.corrcoef(changes[1:], changes[:-1])[0, 1] == pytest.approx(0.25, abs=0.1)
        for resolution in (0.0, 0.01):
            assert look(averaged(one, period_s, resolution), resolution=0.0).kind == "mean"
            assert look(sampled(one, period_s, resolution), resolution=0.0).kind == "periodic"


@pytest.mark.parametrize("period_s", [10.0, 60.0])
@pytest.mark.parametrize("name", STEPS)
def test_means_by_figures_between_the_steps_of_the_sensor(name: str, period_s: float) -> None:
    for seed in SEEDS:
        one = signal(name, seed)
        assert look(averaged(one, period_s), name).kind == "mean"
        assert look(sampled(one, period_s, STEPS[name]), name).kind == "periodic"


@pytest.mark.parametrize("start", [0.0, 123_456.0])
@pytest.mark.parametrize("volume_cm3", [1.0, 10.0])
@pytest.mark.parametrize("period_s", [0.2, 1.0, 10.0])
def test_a_running_total(start: float, volume_cm3: float, period_s: float) -> None:
    for seed in SEEDS:
        flow = wandering(generator(seed), HOURS, 1.5, 0.4, 20.0)
        assert look(counted(flow, period_s, volume_cm3, start), "flow").kind == "cumulative"
    # In litres with decimals, as some meters show it; and one that rolls over.
    total = counted(flow, period_s, volume_cm3, start)
    assert look(Signal(total.time_s, total.value / 1000.0), "flow").kind == "cumulative"
    if period_s < 10.0:
        over = counted(flow, period_s, 10.0, rolls_over=10_000.0)
        assert look(over, "flow").kind == "cumulative"


@pytest.mark.parametrize(("volume_cm3", "period_s"), [(1.0, 0.02), (1.0, 0.1), (10, 0.1), (10, 1)])
def test_counts_since_the_sample_before(volume_cm3: float, period_s: float) -> None:
    """None, one or some in a sample; as a flow in l/min as well, whose step is the count."""
    for seed in SEEDS:
        flow = wandering(generator(seed), HOURS, 1.5, 0.4, 20.0)
        one = pulses(flow, period_s, volume_cm3)
        assert look(one, "flow").kind == "pulses"
        as_flow = Signal(one.time_s, one.value * volume_cm3 * 0.06 / period_s)
        assert look(as_flow, "flow").kind == "pulses"


def test_a_coarse_flow_that_is_read_is_no_count() -> None:
    """Steps as large as the noise, and a flow that hovers between two of them."""
    for seed in SEEDS:
        rng = generator(seed)
        for mean, noise in ((1.5, 0.1), (0.55, 0.03), (0.08, 0.02)):
            one = noisy(rng, wandering(rng, HOURS, mean, 0.02, 60.0), noise)
            assert look(sampled(one, 0.2, 0.1), "flow").kind == "periodic"


def test_a_temperature_that_only_rises_is_no_total() -> None:
    time_s = np.arange(3000.0)
    warming = Signal(time_s, np.round(40.0 + time_s / 300.0, 1))
    assert look(warming, "temperature").kind == "periodic"


def test_few_samples_or_no_change_tell_nothing() -> None:
    for count in (0, 1, 5):
        time_s = np.arange(float(count))
        assert look(Signal(time_s, time_s)).kind == "unknown"
        assert words(look(Signal(time_s, time_s))) == ""
    assert look(Signal(np.arange(500.0), np.full(500, 3.0))).kind == "unknown"


@settings(max_examples=25)
@given(
    st.sampled_from(["sent on change", "compressed", "periodic", "cumulative", "pulses"]),
    st.floats(1e-3, 1e3),
    st.floats(1e-3, 1e3),
    st.floats(-1e3, 1e3),
)
def test_neither_magnitude_nor_speed_tells(
    way: str, factor: float, slower: float, offset: float
) -> None:
    """The same samples in another unit, and all times longer or shorter alike."""
    one = LOGGED[way]
    shift = 0.0 if way in ("cumulative", "pulses") else offset
    other = Signal(one.time_s * slower, one.value * factor + shift * factor)
    # Means are told by how long they are, so that this is left out of what is slowed down.
    if way == "periodic":
        other = Signal(one.time_s, other.value)
    name = "flow" if way in ("cumulative", "pulses") else "pressure"
    kind = "irregular" if way in ("sent on change", "compressed") else way
    assert look(other, name, resolution=0.0).kind == kind


FLOW = wandering(generator(9), 1800.0, 1.5, 0.4, 20.0)
LOAD = noisy(generator(8), moving_load(generator(9), 1800.0, (20.0, 250.0), 15.0), 0.05)
LOGGED = {
    "sent on change": sent_on_change(LOAD, 0.2, 0.1, 0.5),
    "compressed": swinging_door(LOAD, 1.0, 0.1, 1.0),
    "periodic": sampled(LOAD, 0.2, 0.1),
    "cumulative": counted(FLOW, 1.0, 1.0),
    "pulses": pulses(FLOW, 0.1, 1.0),
}


def test_samples_are_put_in_order_and_what_is_missing_left_out() -> None:
    one = LOGGED["sent on change"]
    rng = generator(1)
    order = rng.permutation(one.value.size)
    time_us = np.repeat(stamps(one.time_s)[order], 2)
    value = np.repeat(one.value[order], 2)
    value[1::2] = np.nan
    missing = np.tile([False, True], order.size)
    missing[1::4] = False
    assert look_of(RawChannel(time_us, value, missing, 0)) == look(one, resolution=0.0)


PLAIN = {"source": "x", "unit": "l/min"}
MEAN = {"sampling": "mean", "mean_of_s": 10.0}
SENT = {"sampling": "on_change", "longest_silence_s": 60.0}
TOTAL = {"unit": "count", "counts": "cumulative", "volume_per_count_cm3": 1.0}
PULSES = TOTAL | {"counts": "pulses"}


@pytest.mark.parametrize(
    ("config", "agreeing"),
    [
        ({}, {"periodic"}),
        (SENT, {"periodic", "irregular", "mean"}),
        (MEAN, {"periodic", "mean"}),
        (TOTAL, {"cumulative"}),
        (PULSES, {"periodic", "pulses", "irregular", "mean"}),
    ],
    ids=["periodic", "on_change", "mean", "cumulative", "pulses"],
)
def test_a_remark_where_look_and_config_disagree(
    config: dict[str, object], agreeing: set[Kind]
) -> None:
    channel = Channel.model_validate(PLAIN | config)
    kinds: set[Kind] = {"periodic", "irregular", "mean", "cumulative", "pulses"}
    for kind in kinds:
        told = remark(channel, Sampling(kind, 10.0, 30.0, 0.01))
        said = f"configured as {configured(channel)}, looks {words(Sampling(kind, 10.0))}"
        assert told == "" if kind in agreeing else told.startswith(said)
    assert remark(channel, Sampling("unknown")) == ""


def test_a_remark_says_what_to_write() -> None:
    plain = Channel.model_validate(PLAIN)
    for kind, told in {
        "irregular": 'then sampling = "on_change" and longest_silence_s; silences here reach 30 s',
        "mean": 'then sampling = "mean" and mean_of_s = 10',
        "pulses": 'then counts = "pulses", unit = "count" and volume_per_count_cm3',
    }.items():
        assert remark(plain, Sampling(kind, 10.0, 30.0)).endswith(told)


def test_regular_repeats_and_wrong_periods_are_told() -> None:
    sent = Channel.model_validate(PLAIN | SENT)
    assert "45 % of them as the one before" in remark(sent, Sampling("periodic", 0.2, 0.2, 0.45))
    means = Channel.model_validate(PLAIN | MEAN)
    assert remark(means, Sampling("mean", 60.0)) != ""
    assert remark(means, Sampling("periodic", 1.0)) != ""
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
                found = look_of(
                    log.channels[name], is_flow=name == COUNTED, resolution=channel.resolution
                )
                assert (found.kind, remark(channel, found)) == ("periodic", "")
                looked_at += 1
    assert looked_at == 3 * (5 * 4 + 5)
