"""Hardware-in-the-loop tests for everybody: a pytest plug-in."""
