"""What the arm feels: its own friction and masses, the force at its fingertip, and the object's joint behind it."""
