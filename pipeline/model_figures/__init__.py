"""Static figures of a motor type's model, PNG or SVG, from its config files alone."""

from pipeline.model_figures.subject import ModelSubject, choose, subject_of
from pipeline.model_figures.writing import model_figures, write_model_figures

__all__ = ["ModelSubject", "choose", "model_figures", "subject_of", "write_model_figures"]
