"""CAN and CAN FD layouts shared by executor and drives, bus timing, and the stand-in bus for python-can."""
