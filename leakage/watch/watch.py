"""The watch of a motor, night by night: pure, causal, and of fixed size however long the history.

Shiryaev–Roberts over a mixture of starts, shapes and causes (an e-detector; Shin, Ramdas and
Rinaldo 2022, arXiv 2203.03532): ln R beyond a limit tells a change. Ten nights later it is
adopted, and the watch goes on behind it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from leakage.errors import EstimationError
from leakage.watch import keeping
from leakage.watch.adoption import (
    Earlier,
    adopted,
    at_rest,
    begin,
    in_force_of,
    judged,
    new_period,
    settled,
    shortened,
    with_new_wander,
)
from leakage.watch.nights import Array, Estimate, Machine, NightBlocks, Verdict, WatchSettings
from leakage.watch.state import (
    State,
    change_in_force,
    change_since,
    frozen_leakage_at,
    leakage_at,
    on_first_baseline,
    present,
    smallest_change,
)


@dataclass(frozen=True, slots=True)
class Watch:
    """A motor's watch after its newest night."""

    state: State

    @classmethod
    def begin(
        cls, machine: Machine, nights: Sequence[NightBlocks], settings: WatchSettings
    ) -> Watch:
        """The watch after the nights of its baseline, in order.

        Raises EstimationError if there are fewer nights than a baseline needs.
        """
        if len(nights) < settings.baseline_nights:
            raise EstimationError(
                "watch_baseline",
                f"{len(nights)} nights; a baseline needs {settings.baseline_nights}",
            )
        return cls(begin(machine, nights, settings))

    @property
    def day(self) -> int:
        """The newest night."""
        return self.state.day

    @property
    def lack_of_fit(self) -> float:
        """Root mean square share of the baseline's flow that the model misses."""
        return self.state.baseline.lack_of_fit

    def after(self, night: NightBlocks, earlier: Earlier) -> Watch:
        """The watch after one more night.

        `night`: Its blocks; later than all nights before. `earlier`: The nights from a day on up to
        this one, which are asked for where a baseline period begins.
        """
        state = adopted(with_night(self.state, night))
        if state.is_settling:
            return Watch(shortened(settled(state)))
        state = judged(with_new_wander(state))
        if not state.is_settling and state.period_from is not None:
            state = new_period(state, earlier)
        return Watch(shortened(at_rest(state)))

    def with_tank(self, tank: Estimate) -> Watch:
        """The watch that knows the change of the tank's other motors since its own change.

        Only while a change settles: afterwards its name stays.
        """
        in_force = self.state.in_force
        if in_force is None or in_force.found is None:
            return self
        named = in_force_of(
            self.state,
            self.state.evidence_now(),
            in_force.found,
            in_force.change.told_on,
            tank,
        )
        return Watch(replace(self.state, in_force=named))

    def verdict(self) -> Verdict:
        """What is known after the newest night."""
        state = self.state
        return Verdict(
            state.day,
            state.evidence,
            state.settings.limit,
            self.lack_of_fit,
            change_in_force(state),
            on_first_baseline(state, slice(-1, None)),
            present(state),
            smallest_change(state),
            float(state.window.distance[-1]),
        )

    def change_since(self, day: int) -> Estimate | None:
        """Change of all flows from a day on against before; None without nights on both sides."""
        return change_since(self.state, day)

    def leakage_at(self, drives: Array, conditions: Array) -> Estimate:
        """Flow at some conditions by the level of the newest night; as `state.leakage_at`."""
        return leakage_at(self.state, drives, conditions)

    def frozen_leakage_at(self, drives: Array, conditions: Array) -> float:
        """The same by the baseline alone, [l/min]."""
        return frozen_leakage_at(self.state, drives, conditions)

    def arrays(self) -> dict[str, Array]:
        """Numbers to keep, by name."""
        return keeping.arrays_of(self.state)

    @classmethod
    def of_arrays(
        cls, machine: Machine, settings: WatchSettings, arrays: Mapping[str, Array]
    ) -> Watch:
        """The watch that was kept."""
        return cls(keeping.state_of(machine, settings, arrays))


def with_night(state: State, night: NightBlocks) -> State:
    """The state with one more night, of which nothing is detected yet."""
    information, score = state.baseline.information(night)
    distance = state.baseline.distance(night)
    window = state.window.with_night(night.day, information, score, distance)
    sums = state.sums.with_night(window, state.wander)
    return replace(state, window=window, sums=sums, n_nights=state.n_nights + 1)
