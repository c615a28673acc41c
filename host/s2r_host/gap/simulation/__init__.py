"""Forward simulation in MuJoCo, before and after: effects installed, coefficients refitted on where motion ends."""
