"""Recordings as files: check, recover, export, compare, look at."""
