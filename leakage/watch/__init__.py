"""The watch over a motor's nights: what changed, since when, by how much, and through what.

Arrays in, frozen results out; imports nothing but `leakage.physics` and `leakage.errors`. From the
bottom up: `nights` (what goes in and comes out), `choices` (constants, with their reasons),
`within_night` (errors within a night), `baseline` (what the first nights fix), `wander` (errors
from night to night), `causes`, `evidence` (of every start, shape and cause), `attribution` (since,
how much, which cause), `circuit` (beside the circuit's other motors), `state` (with the figures of
the newest nights), `periods` (baseline periods), `adoption` (a change detected, and what it leaves
behind), `watch` (night by night), `comparison` (before and after a date), `intraday` (the night so
far).
"""

from leakage.watch.comparison import Comparison, compare
from leakage.watch.nights import Change, Estimate, Machine, NightBlocks, Verdict, WatchSettings
from leakage.watch.watch import Watch

__all__ = [
    "Change",
    "Comparison",
    "Estimate",
    "Machine",
    "NightBlocks",
    "Verdict",
    "Watch",
    "WatchSettings",
    "compare",
]
