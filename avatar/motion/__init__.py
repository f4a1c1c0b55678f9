"""Motion: clips of SMPL+H poses in our world, and one reader for each kind of pose file."""
