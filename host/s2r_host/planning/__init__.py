"""Sampling model-predictive control through contact: iCEM on MuJoCo batches."""
