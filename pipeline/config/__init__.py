"""Typed config: the only door for settings."""

from pipeline.config.faults import ConfigError, Fault
from pipeline.config.loading import Fleet, MotorSpec, absolute, load_fleet, overlap
from pipeline.config.motors import Channel, Event, MotorFile
from pipeline.config.settings import (
    Alarms,
    Cleaning,
    Estimation,
    Execution,
    Look,
    Nights,
    Retention,
    SensorHealth,
    Settings,
    Smoothing,
    TimeBase,
    TransportDelay,
    Trend,
    Windows,
)

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
