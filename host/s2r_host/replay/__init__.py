"""Replaying recorded plans and comparing the recordings."""
