"""The effort residual as one whitened regression: rows, noise floor, terms, fits and the evidence for them."""
