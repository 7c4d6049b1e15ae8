"""Figures of a motor type, and their files."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from functools import partial, singledispatch
from pathlib import Path

from matplotlib.figure import Figure

from leakage import AnnularGap, Constant, Laminar, LeakageError, SpeedCurve
from leakage.physics.paths import LeakagePath
from pipeline.errors import UsageError
from pipeline.model_figures.canvas import ImageFormat, drawing, save
from pipeline.model_figures.films import films_figure
from pipeline.model_figures.flows import laminar_figure, pressure_figure, speed_curve_figure
from pipeline.model_figures.gaps import deformation_figure, leakage_figure
from pipeline.model_figures.shares import shares_figure
from pipeline.model_figures.subject import ModelSubject
from pipeline.model_figures.viscosity import viscosity_figure

Draw = Callable[[], Figure]


def model_figures(subject: ModelSubject) -> Mapping[str, Draw]:
    """The figures of a motor type by name: of each path by its law, oil, shares and films.

    A figure is drawn when it is called. A constant flow has none of its own.
    """
    figures: dict[str, Draw] = {}
    for path in subject.motor.paths:
        figures |= dict(_figures_of(path, subject))
    figures["viscosity"] = partial(viscosity_figure, subject)
    figures["shares"] = partial(shares_figure, subject)
    gaps = [path for path in subject.motor.paths if isinstance(path, AnnularGap)]
    if gaps:
        figures["films"] = partial(films_figure, subject, gaps)
    return figures


@singledispatch
def _figures_of(path: LeakagePath, subject: ModelSubject) -> Iterator[tuple[str, Draw]]:
    """Figures of a path of a law that has none of its own: leakage over pressure."""
    yield f"{path.name}_leakage", partial(pressure_figure, subject, path)


@_figures_of.register
def _(path: AnnularGap, subject: ModelSubject) -> Iterator[tuple[str, Draw]]:
    yield f"{path.name}_leakage", partial(leakage_figure, subject, path)
    if path.deformation_pressure_pa is not None:
        yield f"{path.name}_deformation", partial(deformation_figure, subject, path)


@_figures_of.register
def _(path: SpeedCurve, subject: ModelSubject) -> Iterator[tuple[str, Draw]]:
    yield f"{path.name}_speed_curve", partial(speed_curve_figure, subject, path)


@_figures_of.register
def _(path: Laminar, subject: ModelSubject) -> Iterator[tuple[str, Draw]]:
    yield f"{path.name}_leakage", partial(laminar_figure, subject, path)


@_figures_of.register
def _(path: Constant, subject: ModelSubject) -> Iterator[tuple[str, Draw]]:  # noqa: ARG001
    yield from ()


def write_model_figures(
    subject: ModelSubject, folder: Path, image_format: ImageFormat = "png"
) -> list[Path]:
    """Draw all figures of a motor type into a folder as ``<motor type>_<figure>.<format>``.

    The folder is made; files of the same names are replaced, others stay.

    Raises UsageError (``model_range``) if the model does not hold over the range of a figure,
    StoreError (``store_write``) if a file cannot be written.
    """
    written = []
    with drawing():
        for name, draw in model_figures(subject).items():
            path = folder / f"{subject.motor.motor_type}_{name}.{image_format}"
            try:
                figure = draw()
            except LeakageError as error:
                raise UsageError(
                    "model_range", f"{path.name}: {error}; correct the oil's values"
                ) from error
            save(figure, path, image_format)
            written.append(path)
    return written
