"""Everything that can be left out of a model: the contract's catalogue and eight families outside it."""
