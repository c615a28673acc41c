"""Generated protobuf classes (committed; `scripts/generate` rebuilds them)."""
