"""The command that writes the simulated fleet."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def demo(
    folder: Annotated[Path, typer.Argument(help="Gets demo/, and configs/ where it has none.")],
    nights: Annotated[int, typer.Option(min=1, help="Nights of logs.")] = 75,
    minutes: Annotated[float, typer.Option(min=1.0, help="Minutes of log a night.")] = 90.0,
    rate: Annotated[float, typer.Option(min=0.1, help="Samples a second.")] = 5.0,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the simulation.")] = 1,
    slow_errors: Annotated[
        float, typer.Option(min=0.0, help="Minutes that errors of the flow remember; 0: seconds.")
    ] = 0.0,
    jobs: Annotated[int, typer.Option(min=1, help="Worker processes.")] = 2,
) -> None:
    """Write logs of a simulated fleet in three formats to demo/, and the truth beside them.

    Example: motor-leakage demo . --nights 3

    They are the logs of the fleet configs/fleet.toml, which the examples of the other commands
    name. Its tables go to out/.
    """
    from pipeline.demo import write_demo

    write_demo(
        folder,
        nights=nights,
        minutes=minutes,
        rate_hz=rate,
        seed=seed,
        workers=jobs,
        slow_errors_min=slow_errors,
    )
    config = folder / "configs" / "fleet.toml"
    typer.echo(f"logs written to {folder / 'demo' / 'logs'}; the fleet's config is {config}")
