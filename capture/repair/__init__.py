"""Noisy poses and wrong masks of a capture, put right before training."""
