"""Commands that need no logs: figures of a motor type's model, and the simulated fleet."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

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


def draw_model(
    motor_type: Annotated[str, typer.Option("--type", help="Motor type, such as CB560.")],
    config: Annotated[
        Path | None, typer.Option(metavar="FLEET", help="The fleet file; else the shipped config.")
    ] = None,
    output: Annotated[
        Path | None, typer.Option(help="Folder of the figures; else figures/ in the output.")
    ] = None,
    image_format: Annotated[
        Literal["png", "svg"], typer.Option("--format", help="Kind of the files.")
    ] = "png",
    oil: Annotated[
        str | None, typer.Option(help="The oil; else that of the fleet's first motor of the type.")
    ] = None,
) -> None:
    """Draw the model of a motor type as its config states it: each path, oil, shares, films.

    Nothing is fitted: gap heights and eccentricities are the configured ones, and the settings
    are the fleet's, without what a motor overrides. Prints the files that were written.

    Example: motor-leakage model --type CB560 --config configs/fleet.toml --format svg
    """
    from pipeline.config import load_fleet
    from pipeline.demo import shipped_configs
    from pipeline.model_figures import choose, write_model_figures

    fleet = load_fleet(config or shipped_configs() / "fleet.toml")
    subject = choose(fleet, motor_type, oil)
    # The shipped config lies within the program, and its output folder too.
    folder = output or (fleet.output if config else Path("out").resolve()) / "figures"
    for path in write_model_figures(subject, folder, image_format):
        typer.echo(path)
