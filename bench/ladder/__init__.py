"""Rungs of accuracy against time, measured on this machine."""
