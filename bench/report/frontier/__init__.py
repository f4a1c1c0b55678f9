"""Accuracy against time as one HTML page that plays (`selfscan bench` writes it as bench.html).

page.py      rows, pictures and the avatar itself as text
chart.js     time against FLIP, to point at
report.js    the budget, the same frame in each rung, the avatar drawn here and timed on the reader's device
"""
