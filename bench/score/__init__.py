"""Scores of regions: distances and pictures against the truth."""
