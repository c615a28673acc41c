"""From depth frames to what moved and along which joint."""
