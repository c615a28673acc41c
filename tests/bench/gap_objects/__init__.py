"""Recordings of concealed objects as an arm feels them, and what the gap tool says to them."""
