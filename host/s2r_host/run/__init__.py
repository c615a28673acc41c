"""One run: look, push, build, plan, execute, measure, correct, report."""
