"""A D415-like active-stereo depth camera by ray casting."""
