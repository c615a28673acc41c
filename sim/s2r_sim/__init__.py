"""The stand-in for the lab: arm, object, drives, bus and depth camera in MuJoCo."""
