"""Procedural articulated objects with hidden parameters."""
