"""Typed config: the only door for settings."""

from pipeline.config.channels import Channel
from pipeline.config.execution import Execution, Retention
from pipeline.config.faults import ConfigError, Fault
from pipeline.config.fitting import Estimation
from pipeline.config.fleet import Fleet, MotorSpec, absolute, overlap
from pipeline.config.loading import load_fleet
from pipeline.config.motors import Event, MotorFile
from pipeline.config.preparation import (
    Cleaning,
    Nights,
    SensorHealth,
    Smoothing,
    TimeBase,
    TransportDelay,
    Windows,
)
from pipeline.config.settings import Settings
from pipeline.config.watching import Alarms, Look, Trend

__all__ = [
    "Alarms",
    "Channel",
    "Cleaning",
    "ConfigError",
    "Estimation",
    "Event",
    "Execution",
    "Fault",
    "Fleet",
    "Look",
    "MotorFile",
    "MotorSpec",
    "Nights",
    "Retention",
    "SensorHealth",
    "Settings",
    "Smoothing",
    "TimeBase",
    "TransportDelay",
    "Trend",
    "Windows",
    "absolute",
    "load_fleet",
    "overlap",
]
