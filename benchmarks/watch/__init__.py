"""The watch over a motor's nights: false alarms, delays, names and sizes, beside simpler methods.

Each cell is a number of motors to which the same happens, each with a seed of its own; the figures
are of seeds that were not used while building. `--only PATTERN` measures the cells whose name
matches (`group; words; machine; baseline`), `--motors N` fewer motors of each, `--list` shows them;
`--trial` takes other seeds, and shows what is found without keeping it. The limits of the methods
that users would make come first (`--only limits`).
"""

from benchmarks.watch.command import main

__all__ = ["main"]
