"""Figures of each night: indicators, the filter over poor nights, the effect of temperature."""
