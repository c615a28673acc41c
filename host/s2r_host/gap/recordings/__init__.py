"""Recordings as their files have them: read, converted to SI, checked by name. Nothing here knows the model."""
