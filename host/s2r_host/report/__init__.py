"""Run reports: one HTML file that opens offline."""

from s2r_host.report.page import write_report

__all__ = ["write_report"]
