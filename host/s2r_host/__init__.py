"""The host: from depth frames to a physics model, a plan in it, and its execution over the wire."""
