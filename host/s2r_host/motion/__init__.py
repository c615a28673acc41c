"""Where the arm can go: inverse kinematics, collision-free motions, pushes, retreats."""
