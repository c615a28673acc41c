"""Benchmarks of the planner: random tasks, planners side by side, a verifier of its own."""
