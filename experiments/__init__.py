"""Not installed: the paper's tables and ablations, noise, presets, speed against peers,
and how the data in the package was made.
"""
