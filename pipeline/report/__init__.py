"""The report: a folder of pages, made from the tables alone, that opens from a file share."""

from pipeline.report.build import KnownMotor, ReportRequest, ReportResult, build_report

__all__ = ["KnownMotor", "ReportRequest", "ReportResult", "build_report"]
