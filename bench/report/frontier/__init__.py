"""Accuracy against time as one HTML page that plays (`selfscan bench` writes it as bench.html)."""
