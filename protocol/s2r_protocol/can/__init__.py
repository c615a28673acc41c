"""CAN and CAN FD layouts shared by executor and drives, and the stand-in bus for python-can."""
