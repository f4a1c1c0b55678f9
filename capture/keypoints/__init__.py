"""Keypoints that detectors found in the pictures of a video: one record behind all of their formats."""
