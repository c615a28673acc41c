"""Public recordings of real machines, brought to the input form of `s2r gap`; one file per machine."""
