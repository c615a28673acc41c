"""Run reports: one HTML file that opens offline."""
