"""The CAN bus model and the emulated CiA 402 drives on it."""
