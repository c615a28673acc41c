"""What a run writes: answer, patched model, predictions, report, baselines, the next experiment."""
